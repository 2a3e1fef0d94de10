"""Text of a measurement file into rows of fields, whatever program saved it.

Spreadsheets differ in what they put between fields (comma, semicolon, tab), in the
decimal sign, in the encoding and in what they leave at the ends of lines.
"""

from __future__ import annotations

import csv
import difflib
import io
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from datagen.atomic import reason
from datagen.errors import FileError

from .columns import NUMBERS, TEXTS, column_of

SEPARATORS = (",", ";", "\t")

NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?")
"""A plain number with a decimal point or a decimal comma."""

MINUS = "\N{MINUS SIGN}"
"""Written by word processors and plots where a number has a hyphen."""

THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}")
"""A number whose comma may part thousands as well as be a decimal one."""

MISSING = {"nan", "na", "n/a", "#n/a", "#nv", "-", "none", "null"}
"""Words that programs write for a value that is not there, in lower case."""

ENOUGH = 3
"""Known columns by which the headings are told from the lines of a title."""

FOLDED = 5
"""Lines that a heading may run over in its quotation marks."""

TITLE = 40
"""Lines that a title may have."""


MOST = 200
"""Problems after which a file is read no further: a column in the wrong place is one
in every line, and they all stay in memory."""


class MeasurementError(FileError):
    """A measurement file says something that it must not.

    Parameters
    ----------
    path : object
        The file.
    problems : tuple of (place, text)
        Place is ``FILE:LINE``; the first one makes the message.
    """

    def __init__(self, path: object, problems: tuple[tuple[str, str], ...]) -> None:
        self.problems = problems
        place, text = problems[0]
        more = ""
        if len(problems) > 1:
            places = list(dict.fromkeys(p.rpartition(":")[2] for p, _ in problems[1:]))
            shown = ", ".join(places[:8]) + (", ..." if len(places) > 8 else "")
            lines = "line" if len(places) == 1 else "lines"
            count = f"{len(problems) - 1} more"
            if len(problems) >= MOST:
                count = f"at least {count}"
            more = f" (and {count}, {lines} {shown})"
        super().__init__(place, text + more)
        self.path = str(path)

    def __reduce__(self) -> tuple[object, ...]:
        return (type(self), (self.path, self.problems))


def short(place: str) -> str:
    """``FILE:LINE`` without the file's folder."""
    file, _, line = place.rpartition(":")
    return f"{Path(file).name}:{line}"


@dataclass
class Complaints:
    """Problems of one file, collected so that they are told together."""

    path: object
    problems: list[tuple[str, str]] = field(default_factory=list)

    def add(self, place: str, text: str) -> None:
        """Note one; at `MOST` of them all are raised at once."""
        self.problems.append((place, text))
        if len(self.problems) >= MOST:
            self.settle()

    def settle(self) -> None:
        """Raise what was collected, if anything was."""
        if self.problems:
            raise MeasurementError(self.path, tuple(self.problems))


@dataclass(frozen=True)
class Row:
    """One reading as text.

    Parameters
    ----------
    place : str
        ``FILE:LINE`` where it is written.
    texts : dict of str to str
        Fields that are not empty, by SI field name.
    places : dict of str to str
        Where single fields are written that stand elsewhere.
    """

    place: str
    texts: dict[str, str]
    places: dict[str, str] = field(default_factory=dict)

    def where(self, name: str) -> str:
        return self.places.get(name, self.place)

    @property
    def line(self) -> str:
        """The line in words."""
        return f"line {self.place.rpartition(':')[2]}"


@dataclass(frozen=True)
class Table:
    """Rows and the columns that they may have.

    Parameters
    ----------
    path : Path
    place : str
        ``FILE:LINE`` of the headings.
    factors : dict of str to float
        SI per unit of each column that is there, by SI field name.
    rows : tuple of Row
    decimal : str
        Decimal sign of all numbers.
    warnings : tuple of str
    unknown : tuple of str
        Headings that are not known, with what they may have been meant for.
    headings : dict of str to str
        As they are written, by SI field name.
    """

    path: Path
    place: str
    factors: dict[str, float]
    rows: tuple[Row, ...]
    decimal: str
    warnings: tuple[str, ...]
    unknown: tuple[str, ...] = ()
    headings: dict[str, str] = field(default_factory=dict)

    def in_bench_unit(self, name: str) -> bool:
        """Whether a number is written in the unit that messages speak of."""
        return self.factors.get(name) in (None, NUMBERS[name].bench.factor)


def read_bytes(path: Path) -> bytes:
    """All of a file, or a `FileError` that says why not."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise FileError(path, f"cannot be read: {reason(error)}") from error
    except ValueError as error:  # a name with a zero byte
        raise FileError(repr(str(path)), f"cannot be read: {error}") from error


def decode(path: Path, data: bytes) -> tuple[str, list[str]]:
    """Text of a file and what was odd about its encoding."""
    wide = data.startswith((b"\xff\xfe", b"\xfe\xff"))
    encoding = "utf-16" if wide else "utf-8-sig"
    try:
        text, odd = data.decode(encoding), []
    except UnicodeDecodeError:
        text = data.decode("cp1252", errors="replace")
        odd = [f"{path.name}: not UTF-8; read as Windows text (cp1252)"]
    if "\0" in text:
        raise FileError(path, "not a text file; save the table as CSV (UTF-8)")
    return text, odd


def lines_of(path: Path, text: str, separator: str) -> Iterator[tuple[int, list[str]]]:
    """Numbers and stripped fields of the lines that are not empty.

    A field in quotation marks may run over several lines, unless there is a separator
    in it as well: then it may be that a mark is lost, and others' fields in it.
    """
    content = io.StringIO(text, newline="")
    reader = csv.reader(content, delimiter=separator, skipinitialspace=True)
    before = 0
    try:
        for fields in reader:
            number, lines, before = (
                before + 1,
                reader.line_num - before,
                reader.line_num,
            )
            if lines > 1 and not _closed(fields, separator):
                words = f'a field with {separator!r} in it runs over several lines: a "'
                raise FileError(f"{path}:{number}", f"{words} may not be closed")
            stripped = [_on_one_line(one) for one in fields]
            if any(stripped):
                yield number, stripped
    except csv.Error as error:
        raise FileError(f"{path}:{before + 1}", f"not CSV: {error}") from error


def _closed(fields: list[str], separator: str) -> bool:
    """Whether no field that runs over several lines has a separator in it."""
    return not any(re.search(r"[\r\n]", one) and separator in one for one in fields)


def _on_one_line(field: str) -> str:
    return re.sub(r"\s*[\r\n]+\s*", " ", field.strip())


def _split(path: Path, number: int, lines: list[str], separator: str) -> list[str]:
    """Fields of a line, and of those below it where a field in it runs on."""
    try:
        content = (f"{line}\n" for line in lines)
        reader = csv.reader(content, delimiter=separator, skipinitialspace=True)
        fields = next(reader)
        runs_on = reader.line_num > 1
        if runs_on and (reader.line_num > FOLDED or not _closed(fields, separator)):
            line = lines[:1]
            fields = next(csv.reader(line, delimiter=separator, skipinitialspace=True))
    except csv.Error as error:
        raise FileError(f"{path}:{number}", f"not CSV: {error}") from error
    return [_on_one_line(one) for one in fields]


def _known(heading: str) -> bool:
    try:
        return column_of(heading) is not None
    except ValueError:
        return True


def _headings(path: Path, text: str) -> tuple[str, int, list[str], int]:
    """Separator, line number and headings: the first line with `ENOUGH` of our columns.

    Where there is none, the first that is no comment.  The last number returned is the
    line of a title, which stands above the headings, or 0.
    """
    first: tuple[str, int, list[str], int] | None = None
    # Not by `splitlines`, which knows ends of lines that CSV does not.
    lines = re.split(r"\r\n|\r|\n", text)
    for number, line in enumerate(lines, 1):
        if re.fullmatch(r"sep=.?", line.strip(), re.IGNORECASE):
            continue  # a spreadsheet's own note on the separator
        if not line.strip(" \t,;") or line.lstrip(' \t"').startswith("#"):
            continue
        here = lines[number - 1 : number + FOLDED]
        split = {s: _split(path, number, here, s) for s in SEPARATORS}
        known = {s: sum(map(_known, split[s])) for s in SEPARATORS}
        best = max(SEPARATORS, key=known.__getitem__)
        if known[best] >= ENOUGH:
            return best, number, split[best], first[1] if first else 0
        first = first or (best, number, split[best], 0)
        if number > first[1] + TITLE:
            break
    if first:
        return first
    raise FileError(path, "is empty; allowed: a line of headings and readings below")


def read_table(path: Path, data: bytes) -> Table:
    """Rows of a CSV file.

    Raises
    ------
    FileError
        When it is not a text file or empty.
    MeasurementError
        When headings are repeated or have a wrong unit, a line has too many fields,
        or decimal points and commas are mixed.
    """
    text, warnings = decode(path, data)
    separator, top, headings, title = _headings(path, text)
    complaints = Complaints(path)
    place = f"{path}:{top}"
    if title:
        warnings.append(f"{path.name}:{title}: left out: stands above the headings")
    fields: list[str | None] = []
    factors: dict[str, float] = {}
    first: dict[str, str] = {}
    unknown: list[str] = []
    for heading in headings:
        fields.append(None)
        try:
            found = column_of(heading)
        except ValueError as error:
            complaints.add(place, str(error))
            continue
        if found is None:
            if heading:
                unknown.append(_unknown(heading))
                warnings.append(f"{path.name}:{top}: {unknown[-1]}")
            continue
        name, factor = found
        if name in factors:
            complaints.add(
                place, f"columns {first[name]!r} and {heading!r} are the same quantity"
            )
            continue
        fields[-1], factors[name], first[name] = name, factor, heading
        column = NUMBERS.get(name)
        if column and factor != column.bench.factor:
            warnings.append(
                f"{path.name}:{top}: column {heading!r} is read in its own unit and "
                f"converted to {column.unit} ({column.name})"
            )
    complaints.settle()
    rows = []
    cut: list[tuple[str, str]] = []
    nameless: list[tuple[int, str, str]] = []
    for number, texts in lines_of(path, text, separator):
        if number <= top:
            continue
        here = f"{path}:{number}"
        beyond = [one for one in texts[len(headings) :] if one]
        if beyond:
            hint = "; decimal commas need semicolons or tabs between the fields"
            complaints.add(
                here,
                f"{len(texts)} fields, but {len(headings)} headings; extra: "
                f"{beyond[0]!r}" + (hint if separator == "," else ""),
            )
            continue
        lacking = [one for one in headings[len(texts) :] if one]
        if lacking:
            cut.append((here, f"{len(texts)} fields, but {len(headings)} headings"))
        own = {n: t for n, t in zip(fields, texts, strict=False) if n and t}
        for position, (heading, one) in enumerate(zip(headings, texts, strict=False)):
            if not heading and one:
                nameless.append((position, here, one))
        rows.append(Row(here, own))
    if nameless and _counts_rows(nameless, len(rows)):
        words = "without a heading: holds the numbers of the rows and is left out"
        warnings.append(f"{path.name}:{top}: first column {words}")
        nameless = []
    for position, here, one in nameless:
        words = f"{one!r} stands in column {position + 1}, which has no heading; "
        complaints.add(here, f"{words}allowed: a heading over every column")
    complaints.settle()
    if not rows:
        raise FileError(place, "no readings below the headings")
    if cut:
        more = f", and {len(cut) - 1} lines more" if len(cut) > 1 else ""
        warnings.append(
            f"{short(cut[0][0])}: {cut[0][1]}; the last are taken for missing{more}: "
            "is a separator lost?"
        )
    decimal = decimal_sign(path, rows)
    told = tuple(warnings), tuple(unknown), first
    return Table(path, place, factors, tuple(rows), decimal, *told)


def _counts_rows(nameless: list[tuple[int, str, str]], rows: int) -> bool:
    """Whether the first column alone has no heading, and numbers the rows from 0 or 1.

    Data frames are written so.
    """
    found = [text for column, _, text in nameless if column == 0]
    return len(found) == len(nameless) and any(
        found == [str(i) for i in range(start, rows + start)] for start in (0, 1)
    )


def _unknown(heading: str) -> str:
    known = [*TEXTS, *(column.name for column in NUMBERS.values())]
    near = difflib.get_close_matches(heading, known, 1, 0.75)
    hint = f"; did you mean {near[0]}?" if near else ""
    return f"column {heading!r} is not known and left out{hint}"


def decimal_sign(path: Path, rows: list[Row]) -> str:
    """Decimal point or comma of a file's numbers.

    Raises
    ------
    MeasurementError
        When both are there: one of them may part thousands.
    """
    first: dict[str, tuple[str, str, str]] = {}
    parted: dict[str, tuple[str, str]] = {}  # as thousands are, by column
    whole: set[str] = set()  # columns with larger numbers than those have parts
    surely = False
    for row in rows:
        for name, text in row.texts.items():
            text = text.replace(MINUS, "-")
            if name in NUMBERS and NUMBER.fullmatch(text):
                for sign in ".,":
                    if sign in text:
                        first.setdefault(sign, (row.where(name), name, text))
                if THOUSANDS.fullmatch(text):
                    parted.setdefault(name, (row.where(name), text))
                elif "," in text:
                    surely = True
                elif re.fullmatch(r"[+-]?\d{3,}", text):
                    whole.add(name)
    doubtful = [] if surely else [name for name in parted if name in whole]
    if doubtful:
        place, text = parted[doubtful[0]]
        complaints = Complaints(path)
        complaints.add(
            place,
            f"{NUMBERS[doubtful[0]].name}: {text!r} may be {text.replace(',', '.')} or "
            f"{text.replace(',', '')}; allowed: no sign between thousands, and decimal "
            "commas that are seen to be some",
        )
        complaints.settle()
    if len(first) == 2:
        place, name, text = first[","]
        other = first["."]
        complaints = Complaints(path)
        complaints.add(
            place,
            f"{NUMBERS[name].name}: {text!r} has a decimal comma, but {other[2]!r} in "
            f"line {other[0].rpartition(':')[2]} a decimal point; allowed: one of them "
            "in a file, and no sign between thousands",
        )
        complaints.settle()
    return "," if "," in first else "."
