"""The sub-commands of the command line, one module each: a function that adds its arguments and one that runs it."""
