"""The command line: ``previs view | record | info | diff | bench | doctor``.

Exit status: 0 done, 1 it could not be done (one line on stderr says what and why), 2 wrong arguments.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

from .errors import PrevisError

_COMMANDS = {
    "view": "open a stage in a window, see it lit, tune it live",
    "record": "render frames of a stage to picture files",
    "info": "what is in a stage, how it would be rendered, what is not shown as authored",
    "diff": "how far one picture is from another",
    "bench": "how accurate and how fast each way to render is, as a page with plots and tables",
    "doctor": "whether this machine can render, and what to do if not",
}


class _Parser(argparse.ArgumentParser):
    """Says what is wrong with the arguments in one line; the usage, twenty lines here, is left to --help."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {' '.join(message.split())} (see {self.prog} --help)\n")


class _CommandParser(_Parser):
    """The parser of one command, which loads the command's module when it is the one that was asked for."""

    module = ""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[argparse.Namespace, list[str]]:
        if self.module:
            module = importlib.import_module(f".commands.{self.module}", __package__)
            self.module = ""
            module.add_arguments(self)
            self.set_defaults(run=module.run, parser=self)
        return super().parse_known_args(args, namespace)


class _Version(argparse.Action):
    """Prints the version; what finds it out is loaded only then."""

    def __init__(self, option_strings: Sequence[str], dest: str) -> None:
        super().__init__(option_strings, dest, nargs=0, help="show program's version number and exit")

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from importlib.metadata import version

        print(f"previs {version('previs')}")
        parser.exit()


def build_parser() -> argparse.ArgumentParser:
    """The parser of all commands."""
    parser = _Parser(
        prog="previs", description="A volumetric previewer for USD stages: smoke, clouds and fire, lit and shadowed."
    )
    parser.add_argument("--version", action=_Version)
    commands = parser.add_subparsers(
        dest="command", required=True, metavar="|".join(_COMMANDS), parser_class=_CommandParser
    )
    for name, summary in _COMMANDS.items():
        command = commands.add_parser(name, help=summary, description=summary[0].upper() + summary[1:] + ".")
        command.module = name
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit status."""
    # Only small matrices are multiplied here: the threads that numpy makes for large ones take a part of the start,
    # and then of the processor that a software rasteriser draws with.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    parsed, unknown = build_parser().parse_known_args(arguments)
    if unknown:
        # argparse itself would point to the help of previs, which lists no options of the command.
        parsed.parser.error(f"unknown argument: {' '.join(unknown)}")
    try:
        status = parsed.run(parsed)
        # Here and not by the interpreter at its end, where a reader that went away cannot be caught.
        sys.stdout.flush()
        return status
    except PrevisError as error:
        print(f"previs {parsed.command}: {' '.join(str(error).split())}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        return 130
    except BrokenPipeError:
        # The reader of our output went away; Python would complain once more while closing stdout.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1


if __name__ == "__main__":
    sys.exit(main())
