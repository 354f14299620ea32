"""The 4D model: Gaussians, their motion, and the window they are fitted in."""
