"""From the render index to a picture: the plan, the passes and everything that touches OpenGL (besides the window)."""
