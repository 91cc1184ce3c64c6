"""Speed reported against error, and stability on hard cases: what `previs bench` runs.

On top of everything else: nothing below imports it.
"""
