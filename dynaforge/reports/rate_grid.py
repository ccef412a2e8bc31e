"""A table of rates as text: for the terminal, in Markdown and in LaTeX, with the best bold, the second underlined."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from rich.table import Table

from dynaforge.evaluation.dgr import render
from dynaforge.evaluation.rate_table import Rate, RateTable

NOT_AVAILABLE = "N/A"
NOT_MEASURED = "-"
MARKS = ("*", "+")
"""What follows the best and the second-best rate where text can be neither bold nor underlined."""

_WIDTH = 240  # columns at most; a table of nine tasks has about 190
_LATEX = str.maketrans({letter: f"\\{letter}" for letter in "%_&#$"} | {"±": "$\\pm$", "Δ": "$\\Delta$"})


@dataclass(frozen=True, slots=True)
class Cell:
    """A cell of the table.

    Attributes:
        text: The rate, or what is there instead.
        std: Its spread; "" without one.
        place: 0 for the best of its column, 1 for the second best; None for the others.
    """

    text: str
    std: str = ""
    place: int | None = None

    @property
    def plain(self) -> str:
        """The cell in a terminal."""
        text = f"{self.text} ±{self.std}" if self.std else self.text
        return text if self.place is None else text + MARKS[self.place]

    @property
    def markdown(self) -> str:
        """The cell in Markdown; what it cannot underline is underlined by HTML."""
        text = self.text if self.place is None else (f"**{self.text}**", f"<u>{self.text}</u>")[self.place]
        return f"{text} ±{self.std}" if self.std else text

    @property
    def latex(self) -> str:
        """The cell in LaTeX, with the macro `DGRstd` of the paper."""
        text = self.text.translate(_LATEX)
        if self.place is not None:
            text = f"\\{('textbf', 'underline')[self.place]}{{{text}}}"
        return f"{text}\\DGRstd{{{self.std}}}" if self.std else text


@dataclass(frozen=True, slots=True)
class Line:
    """A line of the table: its label, and a cell for each task and for the mean; a rule goes before it if it opens."""

    label: str
    cells: tuple[Cell, ...]
    opens: bool = False


def rate_lines(table: RateTable, labels: Sequence[tuple[str, str]], refused: Iterable[tuple[str, str]]) -> list[Line]:
    """Return a line for each generator.

    Args:
        table: The rates.
        labels: Rows with their labels, in order.
        refused: Pairs of row and task that the generator does not support.
    """
    unsupported = set(refused)

    def cell(row: str, task: str | None) -> Cell:
        rate = table.mean(row) if task is None else table.rate(row, task)
        if rate is None:
            return Cell(NOT_AVAILABLE if task is not None and (row, task) in unsupported else NOT_MEASURED)
        places = [place for place in (0, 1) if row in table.best(task, place)]
        return rate_cell(rate, places[0] if places else None)

    columns = (*table.tasks, None)
    return [Line(label, tuple(cell(row, task) for task in columns)) for row, label in labels]


def rate_cell(rate: Rate, place: int | None = None) -> Cell:
    """Return the cell of a rate, in per cent with two digits."""
    return Cell(f"{rate.shown:.2f}", f"{100 * rate.std:.2f}", place)


def gain_line(table: RateTable, row: str, over: str) -> Line:
    """Return the line of the paper's gains, in percentage points, of one generator over another."""
    gains = [table.gain(row, over, task) for task in (*table.tasks, None)]
    return Line("Δ (pp)", tuple(Cell(NOT_MEASURED if gain is None else f"{gain:+.2f}") for gain in gains), opens=True)


def plain_table(headings: Sequence[str], lines: Sequence[Line]) -> str:
    """Return lines as a table for the terminal; the headings are those of all columns, the first one included."""
    grid = Table()
    for k, heading in enumerate(headings):
        grid.add_column(heading, justify="right" if k else "left", no_wrap=True)
    for line in lines:
        if line.opens:
            grid.add_section()
        grid.add_row(line.label, *(cell.plain for cell in line.cells))
    return render(grid, _WIDTH)


def markdown_table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return rows of text as a table in Markdown; the headings are those of all columns, the first one included."""
    lines = [headings, ["---", *["---:"] * (len(headings) - 1)], *rows]
    return "\n".join(f"| {' | '.join(text.replace('|', '/') for text in line)} |" for line in lines)


def markdown_lines(headings: Sequence[str], lines: Iterable[Line]) -> str:
    """Return lines as a table in Markdown."""
    return markdown_table(headings, ((line.label, *(cell.markdown for cell in line.cells)) for line in lines))


def latex_table(headings: Sequence[str], skills: Sequence[str], lines: Sequence[Line], *, notes: str) -> str:
    """Return lines as a table in LaTeX, which looks as the paper's does and needs the package booktabs.

    Args:
        headings: Of all columns, the first one included.
        skills: The main skill of each task.
        lines: The lines.
        notes: Text below the table.
    """
    head = " & ".join(f"\\textbf{{{heading.translate(_LATEX)}}}" for heading in headings)
    skill = " & ".join(f"{{\\scriptsize {text}}}" for text in skills)
    body = []
    for line in lines:
        body += ["\\midrule"] if line.opens else []
        body.append(" & ".join((line.label.translate(_LATEX), *(cell.latex for cell in line.cells))) + " \\\\")
    return "\n".join(
        (
            "\\providecommand{\\DGRstd}[1]{\\nobreak\\hspace{0.08em}{\\scriptsize\\ensuremath{\\pm}#1}}",
            "\\begin{table*}[htbp]",
            "\\caption{Matched dynamic demonstration generation.}",
            "\\centering\\footnotesize\\setlength{\\tabcolsep}{1.4pt}\\renewcommand{\\arraystretch}{1.25}",
            f"\\begin{{tabular}}{{@{{}}l*{{{len(headings) - 1}}}{{c}}@{{}}}}",
            "\\toprule",
            f"{head} \\\\",
            "\\midrule",
            f"\\textit{{Dominant skill}} & {skill} & -- \\\\",
            "\\midrule",
            *body,
            "\\bottomrule",
            "\\end{tabular}",
            "\\par\\smallskip\\begin{minipage}{\\textwidth}\\footnotesize",
            f"{notes.translate(_LATEX)}",
            "\\end{minipage}",
            "\\end{table*}",
            "",
        )
    )
