"""From obstacles to the arm's speed: collision scene, checker, separation law."""
