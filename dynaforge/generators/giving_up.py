"""When attempts lead nowhere: an error with the reasons, where waiting longer would not help."""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator, Iterable, Iterator, Sequence
from typing import Any

from dynaforge.demos import Attempt
from dynaforge.generators.attempts import Result

MIN_ATTEMPTS = 50  # attempts that tell as much as any number would, where not one of them goes well


class GaveUp(RuntimeError):  # noqa: N818  the name says what happened
    """Attempts went on without success, or without leaving anything to measure, for as long as was allowed.

    Attributes:
        attempts: All that were made, those of earlier runs included.
        problem: What did not happen in how many of them; the message adds the commonest reasons.
    """

    def __init__(self, problem: str, attempts: Sequence[Attempt]) -> None:
        super().__init__(f"{problem}; {describe_reasons(attempts)}")
        self.problem, self.attempts = problem, list(attempts)

    def __reduce__(self) -> tuple[Any, ...]:
        return GaveUp, (self.problem, self.attempts)


def describe_reasons(attempts: Iterable[Attempt], *, n: int = 3, longest: int = 160) -> str:
    """Say in one line what failed attempts failed with, the commonest first."""
    return describe_counts(
        Counter(attempt.failure for attempt in attempts if not attempt.success), n=n, longest=longest
    )


def describe_counts(reasons: Counter[str], *, n: int = 3, longest: int = 160) -> str:
    """Say in one line how often what was the reason, the commonest first."""
    texts = []
    for reason, count in reasons.most_common(n):
        text = " ".join(reason.split()) or "no reason given"
        texts.append(f"{text if len(text) <= longest else text[: longest - 3] + '...'} ({count})")
    return ", ".join(texts) or "no attempt failed"


def refuse_if_all_raise(results: Iterator[Result], *, generator: str) -> Iterator[Result]:
    """Pass results on; a generator that only raises has no success rate, not even 0 %.

    Args:
        results: Of an engine; closed, with its workers, when that many are enough.
        generator: What attempts.

    Raises:
        GaveUp: None of the first attempts, `MIN_ATTEMPTS` or all there are, left an episode.
    """
    nothing: list[Attempt] = []
    left_any = False
    for result in results:
        left_any = left_any or result.episode is not None
        if not left_any:
            nothing.append(result.attempt)
            if len(nothing) == MIN_ATTEMPTS:
                if isinstance(results, Generator):
                    results.close()
                break
        yield result
    if nothing and not left_any:
        raise GaveUp(f"None of {len(nothing)} attempts by {generator!r} left an episode", nothing)
