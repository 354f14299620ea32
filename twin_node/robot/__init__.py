"""The arm's kinematics and shapes, and what it hides from the cameras."""
