"""README says what is there: its table of knobs is the settings table."""

from pathlib import Path

from previs.settings import TABLE

README = Path(__file__).parents[2] / "README.md"


def knob_rows() -> list[str]:
    """The rows of the table of knobs, as README has to print them."""
    rows = []
    for setting in TABLE:
        default = str(setting.default).lower() if setting.type is bool else str(setting.default)
        rows.append(f"| `{setting.name}` | {default} | {setting.doc} Takes {setting.accepts()}. |")
    return rows


def test_table_of_knobs_is_the_settings_table():
    text = README.read_text(encoding="utf-8")
    missing = [row for row in knob_rows() if row not in text]
    assert not missing, "put into README:\n" + "\n".join(knob_rows())
