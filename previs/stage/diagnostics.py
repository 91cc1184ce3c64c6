"""USD's own warnings, kept off stderr: the user is told in notes and in one-line errors."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator
from contextlib import contextmanager

from pxr import Tf, UsdUtils

_log = logging.getLogger(__name__)
_MESSAGE = re.compile(r" : '(.*?)\n?'(?=\n\tError in|\s*$)", re.DOTALL)


@contextmanager
def quiet_diagnostics() -> Iterator[None]:
    """Meanwhile USD's diagnostics go to the logger `previs.stage.diagnostics` (level DEBUG) instead of stderr."""
    delegate = UsdUtils.CoalescingDiagnosticDelegate()
    try:
        yield
    finally:
        for diagnostic in delegate.TakeUncoalescedDiagnostics():
            _log.debug("%s", diagnostic.commentary)
        # The delegate is unregistered when its last reference goes.
        del delegate


def one_line(error: Tf.ErrorException) -> str:
    """The first cause in a USD error, as one line without USD's source locations."""
    messages = _MESSAGE.findall(str(error)) or [str(error)]
    return " ".join(messages[0].split()).rstrip(".")
