"""The one exception that previs raises for bad input: a sentence for the user, never a traceback."""


class PrevisError(Exception):
    """Something the user gave cannot be used.

    The message is one line that names the file or prim, says what is wrong and what to do about it.
    """
