"""What will be occupied, up to 200 ms ahead."""
