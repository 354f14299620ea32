"""What a run is worth: figures under stable names, and one page that a person would want to look at."""
