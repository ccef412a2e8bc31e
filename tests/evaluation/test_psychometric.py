from __future__ import annotations

import json
import math

import numpy as np
import pytest

from dynaforge.evaluation.psychometric import NEVER_FALLS, NEVER_REACHES, PsychometricCurve, fit_curve
from dynaforge.evaluation.statistics import Interval

SPAN = (0.05, 1.5)
SOME = Interval(0.0, 1.0)


def curve(ceiling: float, midpoint: float, width: float, interval: Interval = SOME) -> PsychometricCurve:
    return PsychometricCurve(ceiling=ceiling, midpoint=midpoint, width=width, span=SPAN, interval=interval)


def drawn(true: PsychometricCurve, n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    x = rng.uniform(*SPAN, size=n)
    return x, rng.random(n) < true.at(x)


def test_the_critical_speed_is_where_the_curve_is_at_one_half() -> None:
    assert curve(1.0, 0.7, 0.1).critical == pytest.approx(0.7)
    # 0.9 / (1 + e^z) = 1/2 at z = log(0.8)
    assert curve(0.9, 0.7, 0.1).critical == pytest.approx(0.7 + 0.1 * math.log(0.8))
    for ceiling in (0.6, 0.75, 1.0):
        some = curve(ceiling, 0.8, 0.2)
        assert float(some.at(some.critical)) == pytest.approx(0.5)


def test_what_has_no_critical_speed_says_so() -> None:
    assert curve(1.0, 2.0, 0.1).critical == NEVER_FALLS  # beyond the range
    assert curve(0.5, 0.7, 0.1).critical == NEVER_REACHES  # the ceiling is too low
    assert curve(1.0, 0.0, 0.1).critical == NEVER_REACHES  # before the range
    assert curve(1.0, 2.0, 0.1, Interval(1.2, math.inf)).describe() == "never falls [1.20, never falls]"
    assert curve(0.2, 0.5, 0.1, Interval(-math.inf, -math.inf)).describe() == "never reaches"
    assert json.loads(json.dumps(curve(1.0, 0.7, 0.1, Interval(0.6, math.inf)).to_dict())) == {
        "ceiling": 1.0,
        "midpoint": 0.7,
        "width": 0.1,
        "span": list(SPAN),
        "critical": 0.7,
        "interval": [0.6, NEVER_FALLS],
    }


@pytest.mark.parametrize("true", [curve(0.9, 0.8, 0.15), curve(1.0, 0.4, 0.05), curve(0.7, 1.0, 0.1)])
def test_a_fit_finds_the_curve_again(true: PsychometricCurve) -> None:
    rng = np.random.default_rng(0)
    fitted = fit_curve(*drawn(true, 20_000, rng), span=SPAN, rng=rng, resamples=20)
    x = np.linspace(*SPAN, 50)
    np.testing.assert_allclose(fitted.at(x), true.at(x), atol=0.02)
    assert fitted.crossing == pytest.approx(true.crossing, abs=0.02)


def test_the_interval_holds_the_critical_speed_about_as_often_as_it_says() -> None:
    rng, true = np.random.default_rng(1), curve(0.9, 0.8, 0.15)
    made = [fit_curve(*drawn(true, 150, rng), span=SPAN, rng=rng, resamples=60) for _ in range(40)]
    held = sum(fit.interval.low <= true.crossing <= fit.interval.high for fit in made)
    assert held >= 33  # 38 expected
    assert all(fit.interval.low <= fit.crossing <= fit.interval.high for fit in made)
    assert np.mean([fit.interval.high - fit.interval.low for fit in made]) < 0.4


def test_where_all_or_none_succeed_the_name_is_certain() -> None:
    x = np.linspace(*SPAN, 60)
    rng = np.random.default_rng(2)
    assert fit_curve(x, np.ones(60), span=SPAN, rng=rng, resamples=50).describe() == NEVER_FALLS
    assert fit_curve(x, np.zeros(60), span=SPAN, rng=rng, resamples=50).describe() == NEVER_REACHES


def test_a_step_is_found_within_the_gap_that_holds_it() -> None:
    x = np.linspace(0.05, 1.5, 146)
    fitted = fit_curve(x, x < 0.655, span=SPAN, rng=np.random.default_rng(3), resamples=50)
    assert fitted.crossing == pytest.approx(0.655, abs=0.01)


def test_the_fit_does_not_depend_on_the_unit() -> None:
    rng = np.random.default_rng(4)
    x, success = drawn(curve(0.9, 0.8, 0.15), 200, rng)
    metres = fit_curve(x, success, span=SPAN, rng=np.random.default_rng(5), resamples=50)
    millimetres = fit_curve(1e3 * x, success, span=(50, 1500), rng=np.random.default_rng(5), resamples=50)
    assert millimetres.crossing == pytest.approx(1e3 * metres.crossing)
    assert millimetres.interval == pytest.approx([1e3 * end for end in metres.interval])


def test_what_cannot_be_fitted_is_refused() -> None:
    rng = np.random.default_rng(6)
    for x, success, span, words in (
        ([], [], SPAN, "non-empty"),
        ([0.1, 0.2], [1], SPAN, "equal"),
        ([0.1], [0.5], SPAN, "success"),
        ([0.1], [1], (1.0, 1.0), "empty"),
    ):
        with pytest.raises(ValueError, match=words):
            fit_curve(x, success, span=span, rng=rng)
