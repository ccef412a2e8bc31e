"""When attempts lead nowhere: an error that gives the reasons."""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator, Iterable, Iterator, Sequence
from typing import Any

from dynaforge.demos import Attempt
from dynaforge.generators.attempts import Result

MIN_ATTEMPTS = 50  # attempts after which more would say nothing new, where none of them succeeds


class GaveUp(RuntimeError):  # noqa: N818  the name says what happened
    """As many attempts as were allowed had no success, or left nothing to measure.

    Attributes:
        problem: What did not happen, and in how many attempts; the message adds the commonest reasons.
        attempts: All attempts, including those of earlier runs.
    """

    def __init__(self, problem: str, attempts: Sequence[Attempt]) -> None:
        super().__init__(f"{problem}; {describe_reasons(attempts)}")
        self.problem, self.attempts = problem, list(attempts)

    def __reduce__(self) -> tuple[Any, ...]:
        return GaveUp, (self.problem, self.attempts)


def describe_reasons(attempts: Iterable[Attempt], *, n: int = 3, longest: int = 160) -> str:
    """Return the commonest reasons of the failed attempts, in one line.

    Args:
        attempts: The attempts, successful or not.
        n: Number of reasons at most.
        longest: Characters of a reason at most.
    """
    return describe_counts(
        Counter(attempt.failure for attempt in attempts if not attempt.success), n=n, longest=longest
    )


def describe_counts(reasons: Counter[str], *, n: int = 3, longest: int = 160) -> str:
    """Return the commonest reasons and how often each occurred, in one line.

    Args:
        reasons: How often each reason occurred.
        n: Number of reasons at most.
        longest: Characters of a reason at most.
    """
    texts = []
    for reason, count in reasons.most_common(n):
        text = " ".join(reason.split()) or "no reason given"
        texts.append(f"{text if len(text) <= longest else text[: longest - 3] + '...'} ({count})")
    return ", ".join(texts) or "no attempt failed"


def refuse_if_all_raise(results: Iterator[Result], *, generator: str) -> Generator[Result, None, None]:
    """Yield the results as they come; a generator that only raises has no success rate, not even 0 %.

    Args:
        results: The results of an engine, which is closed, with its workers, before GaveUp is raised.
        generator: Name of the generator.

    Raises:
        GaveUp: None of the first attempts, `MIN_ATTEMPTS` or all there are, left an episode.
    """
    without_episode: list[Attempt] = []
    any_episode = False
    for result in results:
        any_episode = any_episode or result.episode is not None
        if not any_episode:
            without_episode.append(result.attempt)
            if len(without_episode) == MIN_ATTEMPTS:
                if isinstance(results, Generator):
                    results.close()
                break
        yield result
    if without_episode and not any_episode:
        raise GaveUp(f"None of {len(without_episode)} attempts by {generator!r} left an episode", without_episode)
