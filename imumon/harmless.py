"""Text from a device, a file name or a foreign table made harmless, one function for each kind of output.

Such text may hold escape sequences that write to a terminal, line breaks that forge a line of a log, markup
that a report would carry out, or formulas that a spreadsheet would compute.  What is changed stays readable.
"""

import re

LONGEST_LINE = 2000
"""Characters of a log line; what is longer was not written by a person."""

_CONTROL = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f"  # all but tab and line feed: escape sequences begin with them
    "\u200e\u200f\u202a-\u202e\u2066-\u2069"  # turn the direction of what follows
    "\u2028\u2029\ud800-\udfff]"  # line breaks to some; halves of a character, which cannot be written
)
_MARKDOWN = re.compile(r"([\\`*_{}\[\]<>#|~!&])")
_FORMULA = ("=", "+", "-", "@", "\t", "\r")
"""How a cell begins that spreadsheets compute (OWASP, CSV injection)."""


def for_terminal(text: str) -> str:
    """Show control characters as an escape of Python would; lines and tabs stay."""
    return _CONTROL.sub(lambda found: ascii(found[0])[1:-1], text)


def for_log(text: str) -> str:
    """Do as `for_terminal`, in one line of limited length."""
    one = for_terminal(text).replace("\n", "\\n")
    return one if len(one) <= LONGEST_LINE else f"{one[:LONGEST_LINE]}... ({len(one):,} characters)"


def for_markdown(text: str) -> str:
    """Return one line whose characters mean themselves in a Markdown table."""
    return _MARKDOWN.sub(r"\\\1", for_log(text))


def for_csv(cell: str) -> str:
    """Return the cell of a CSV file: no formula, quoted where it must be."""
    safe = for_terminal(cell)
    safe = f"'{safe}" if safe.startswith(_FORMULA) else safe
    return '"' + safe.replace('"', '""') + '"' if any(mark in safe for mark in ',"\n') else safe


def for_plot(text: str) -> str:
    """Return a label of matplotlib that is shown as it is: no formula between dollars, and not hidden."""
    shown = for_log(text).replace("$", r"\$")
    return f"\u200b{shown}" if shown.startswith("_") else shown


def for_html(value: object) -> object:
    """Return what is put into HTML, before it is escaped, without control characters."""
    return for_terminal(value) if type(value) is str else value
