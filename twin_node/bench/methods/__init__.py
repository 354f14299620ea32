"""`bench methods`: all ways to a dynamic scene, learnt from the same images and scored on the same others."""
