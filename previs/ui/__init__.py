"""The desktop application: ``previs view``.

ImGui and OpenGL are touched only where something is drawn (`app`, `viewport`, `picture` and the panels); what can be
thought and tested without a window has modules of its own.
"""
