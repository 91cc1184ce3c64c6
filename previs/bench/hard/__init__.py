"""The hard cases: small generated scenes at the limits of what media, lights, transforms and files can be.

Every case states what is right for it: a closed form where there is one, else the float64 reference, else an
invariance, a symmetry, continuity, or bounds; every picture on the way is finite and within its bounds. A case passes,
or fails, or is *reported*: the program itself tells the user, by a note or by refusing with one line, what it did. A
published method that is sound, but less accurate than is asked of the default one, is *short* of it.

>>> print(table(run(renderer, methods=["quantile", "march"])))
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from . import files, media, places, several
from .lines import LINES
from .trial import ANY, CASES, Case, Measure, Outcome, Rendering, Trial, case

__all__ = [
    "ANY",
    "CASES",
    "LINES",
    "Case",
    "Measure",
    "Outcome",
    "Rendering",
    "Trial",
    "case",
    "run",
    "run_case",
    "table",
]

# Importing a module registers its cases.
_THEMES = (media, places, several, files)

#: Reference pictures by case, for all methods in this process.
_references: dict[str, dict] = {}


def run_case(renderer: Rendering, chosen: Case, method: str, coefficients: int) -> Outcome:
    """One case with one method; whatever it raises is a verdict about this case."""
    trial = Trial(renderer, method, coefficients, _references.setdefault(chosen.name, {}))
    try:
        chosen.check(trial)
    except Exception as error:
        # A crash is a figure of the table too, and the other cases go on.
        raised = Measure(1.0, 0.0, f"{type(error).__name__} raised", "flag")
        return Outcome(chosen.name, method, coefficients, raised, "FAIL", " ".join(str(error).split()))
    worst, verdict, note = trial.verdict()
    return Outcome(chosen.name, method, coefficients, worst, verdict, note)


def run(
    renderer: Rendering,
    methods: Iterable[str] | None = None,
    names: Iterable[str] | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> list[Outcome]:
    """Run hard cases, each with every method that it is about.

    Args:
        renderer: draws the pictures.
        methods: values of the setting `transmittance`; None takes all.
        names: of cases; None takes all.
        progress: called with the done part in [0, 1] and the name of the next case.

    Raises:
        ValueError: for an unknown case or method.
    """
    names, methods = None if names is None else list(names), None if methods is None else list(methods)
    for what, given, known in (("case", names, CASES), ("method", methods, _known_methods())):
        for name in given or ():
            if name not in known:
                raise ValueError(f"there is no {what} {name!r}; there are: {', '.join(known)}")
    chosen = [CASES[n] for n in (CASES if names is None else names)]
    trials = [(c, m, n) for c in chosen for m, n in c.variants(methods)]
    outcomes = []
    for number, (held, method, coefficients) in enumerate(trials):
        if progress is not None:
            progress(number / len(trials), held.name)
        outcomes.append(run_case(renderer, held, method, coefficients))
    if progress is not None:
        progress(1.0, "")
    return outcomes


def _known_methods() -> tuple[str, ...]:
    return tuple(dict.fromkeys(m for c in CASES.values() for m in c.methods))


def table(outcomes: Sequence[Outcome]) -> str:
    """The outcomes as text, a line per case and method, with what was said below those that were reported."""
    rows = [("case", "method", "verdict", "worst")]
    rows += [(o.case, o.label, o.verdict, o.error + (f"; {o.note}" if o.note else "")) for o in outcomes]
    widths = [max(len(r[i]) for r in rows) for i in range(3)]
    lines = ["  ".join([*(c.ljust(w) for c, w in zip(r, widths, strict=False)), r[3]]).rstrip() for r in rows]
    counts = {v: sum(o.verdict == v for o in outcomes) for v in ("pass", "reported", "short", "FAIL")}
    lines.append(", ".join(f"{n} {v}" for v, n in counts.items()))
    return "\n".join(lines)
