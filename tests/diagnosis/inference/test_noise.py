"""Whitening and what is no white noise, against covariances that are known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from robomill.diagnosis.inference.noise import ORDER, RARE, SHRINKAGE, Whitening, fast, own_noise, whitening
from robomill.orchestration.slaves.protocol import FloatArray
from tests.tolerances import EXACT, ROUNDOFF, chance, of_mean, of_variance

ROWS, REPEATS = 20000, 4
FREE = (REPEATS - 1) * ROWS
"""Independent samples that the covariance is estimated from: the mean of the repeats takes one of them."""
MEAN = math.hypot(of_mean(ROWS), of_mean(FREE))
"""Standard error of a correlation in a series of unit variance that a filter of the repeats was applied to: of both."""
VARIANCE = math.hypot(of_variance(ROWS), of_variance(FREE))
"""Standard error of the variance of that series."""
RIDGE = 1e-9
"""Relative: what is added to the variances of the channels, so that there is a Cholesky factor."""
OFF_THE_EDGE = 0.005
"""Relative: by so much correlations are drawn to zero per sample of distance, so that no drift is differenced away."""


def autoregressive(rng: np.random.Generator, a: float, rows: int = ROWS) -> FloatArray:
    """x(t) = a x(t - 1) + e(t), e of unit variance, from its stationary distribution."""
    e = rng.normal(size=rows)
    e[0] /= math.sqrt(1.0 - a * a)
    return np.asarray(lfilter([1.0], [1.0, -a], e))


def correlations(white: FloatArray, lags: int = 6) -> list[float]:
    """Correlations of a series of zero mean and unit variance with itself, at lags from one sample."""
    return [float(np.mean(white[k:] * white[:-k])) for k in range(1, lags + 1)]


class TestWhitening:
    def test_white_noise_stays_white_and_has_unit_variance(self) -> None:
        rng = np.random.default_rng(1)
        sizes = np.array([0.02, 3.0])
        w = whitening([[sizes * rng.normal(size=(ROWS, 2)) for _ in range(REPEATS)]], np.zeros(2))
        assert not w.guessed
        assert w.deviation == pytest.approx(sizes, rel=chance(0.5 * of_variance(FREE)))
        assert np.abs(w.coefficients).max() <= chance(of_mean(FREE))
        white = w.apply(sizes * rng.normal(size=(ROWS, 2))).reshape(ROWS, 2)[ORDER:]
        for channel in white.T:
            assert np.var(channel) == pytest.approx(1.0, rel=chance(VARIANCE))
            assert correlations(channel) == pytest.approx([0.0] * 6, abs=chance(MEAN))
        assert np.mean(white[:, 0] * white[:, 1]) == pytest.approx(0.0, abs=chance(MEAN))

    @pytest.mark.parametrize("a", [0.8, -0.5])
    def test_the_filter_of_an_autoregressive_series_is_its_own(self, a: float) -> None:
        rng = np.random.default_rng(2)
        w = whitening([[0.1 * autoregressive(rng, a)[:, None] for _ in range(REPEATS)]], np.zeros(1))
        # correlations a^k, drawn to zero by 0.995^k: those of a series with 0.995 a
        expected = [(1.0 - OFF_THE_EDGE) * a, 0.0, 0.0]
        # covariance of estimated coefficients: the inverse of that of the series, over their number (Mann and Wald 1943)
        known = np.sqrt(np.diag(np.linalg.inv(toeplitz(a ** np.arange(3) / (1.0 - a * a)))) / FREE)
        assert np.abs(w.coefficients[0] - expected) == pytest.approx([0.0] * 3, abs=chance(float(known.max())))
        white = w.apply(0.1 * autoregressive(rng, a)[:, None])[ORDER:]
        assert np.var(white) == pytest.approx(1.0, rel=chance(VARIANCE))
        left = OFF_THE_EDGE * abs(a)  # e(t) + left x(t - 1) goes with the sample before
        assert correlations(white) == pytest.approx([0.0] * 6, abs=chance(MEAN) + left)

    def test_what_cannot_be_predicted_of_a_smoothed_series_is_that_of_its_covariance(self) -> None:
        """Means of two white samples: 5/8 of the variance stay with three samples known, (p + 2) / (2 (p + 1)) of p."""
        rng = np.random.default_rng(3)
        made = [rng.normal(size=ROWS + 1) for _ in range(REPEATS)]
        w = whitening([[((e[1:] + e[:-1]) / math.sqrt(2.0))[:, None] for e in made]], np.zeros(1))
        # neighbours share a sample: variances of products have 1 + 2 * 0.5^2 the weight
        assert w.deviation == pytest.approx([1.0], rel=chance(0.5 * of_variance(FREE / 1.5)))
        known = np.linalg.solve(toeplitz([1.0, 0.5, 0.0]), [0.5, 0.0, 0.0])
        assert float(1.0 - known @ [0.5, 0.0, 0.0]) == pytest.approx(5.0 / 8.0, rel=ROUNDOFF)
        assert float(w.factor[0, 0] ** 2) == pytest.approx(5.0 / 8.0, rel=chance(of_variance(FREE)))

    def test_channels_that_go_together_are_parted_but_for_the_part_that_is_not_believed(self) -> None:
        rng = np.random.default_rng(4)
        mixed = np.linalg.cholesky([[1.0, 0.6], [0.6, 1.0]])
        w = whitening([[rng.normal(size=(ROWS, 2)) @ mixed.T for _ in range(REPEATS)]], np.zeros(2))
        believed = np.linalg.cholesky([[1.0, 0.6 * (1.0 - SHRINKAGE)], [0.6 * (1.0 - SHRINKAGE), 1.0]])
        parted = np.linalg.solve(believed, mixed)
        white = w.apply(rng.normal(size=(ROWS, 2)) @ mixed.T).reshape(ROWS, 2)[ORDER:]
        assert white.T @ white / len(white) == pytest.approx(parted @ parted.T, abs=chance(VARIANCE))

    def test_without_noise_there_is_the_floor(self) -> None:
        floor = np.array([0.5, 20.0])
        w = whitening([[np.ones((50, 2))] * 2], floor)
        assert w.coefficients == pytest.approx(np.zeros((2, ORDER)), abs=EXACT)
        assert w.deviation.tolist() == [0.0, 0.0]
        x = np.random.default_rng(5).normal(size=(50, 2))
        assert w.apply(x).reshape(50, 2)[ORDER:] == pytest.approx((x / floor)[ORDER:], rel=RIDGE)

    def test_the_floor_is_white_noise_more(self) -> None:
        """As large as the noise itself: of the noise alone half the variance is left, and of a slow one what can be predicted is less."""
        rng = np.random.default_rng(6)
        w = whitening([[rng.normal(size=(ROWS, 1)) for _ in range(REPEATS)]], np.ones(1))
        assert np.var(w.apply(rng.normal(size=(ROWS, 1)))[ORDER:]) == pytest.approx(0.5, rel=chance(VARIANCE))
        assert w.deviation == pytest.approx([1.0], rel=chance(0.5 * of_variance(FREE)))  # the floor is none of a run
        a, floor = 0.8, 2.0
        slow = whitening([[autoregressive(rng, a)[:, None] for _ in range(REPEATS)]], np.array([floor]))
        r = a ** np.arange(ORDER + 1) / (1.0 - a * a) + floor**2 * np.eye(ORDER + 1)[0]
        known = np.linalg.solve(toeplitz(r[:ORDER]), r[1:])
        # the filter is near the best one, of which the variance is the least
        assert float(slow.factor[0, 0] ** 2) == pytest.approx(float(r[0] - known @ r[1:]), rel=chance(of_variance(FREE * (1.0 - a * a))))

    def test_a_mean_of_repeats_counts_as_so_many(self) -> None:
        rng = np.random.default_rng(7)
        w = whitening([[rng.normal(size=(300, 2)) for _ in range(3)]], np.zeros(2))
        x = rng.normal(size=(300, 2))
        assert w.apply(x, 9.0) == pytest.approx(3.0 * w.apply(x), rel=ROUNDOFF)

    def test_what_is_sudden_counts_for_as_much_less_as_it_is_wider_than_the_noise(self) -> None:
        """Noise of deviation 1 and a sudden one of the root of 3 beside it: half, of one channel and of no other."""
        w = whitening([[np.zeros((300, 2))] * 2], np.array([1.0, 5.0]))
        x = np.random.default_rng(8).normal(size=(300, 2))
        sudden = np.zeros((300, 2))
        sudden[100, 0] = math.sqrt(3.0)
        less = w.apply(x, 1.0, sudden).reshape(300, 2) / np.where(np.arange(600) < 2 * ORDER, 1.0, w.apply(x)).reshape(300, 2)
        expected = np.ones((300, 2))
        expected[:ORDER] = 0.0
        expected[100, 0] = 0.5
        assert less == pytest.approx(expected, rel=RIDGE)

    @pytest.mark.parametrize("begin", [0, 1, 30])
    def test_the_beginning_of_a_run_does_not_count(self, begin: int) -> None:
        rng = np.random.default_rng(9)
        w = whitening([[rng.normal(size=(300, 1)) for _ in range(2)]], np.zeros(1), begin)
        white = w.apply(np.full((300, 1), 7.0))
        assert np.flatnonzero(white)[0] == max(begin, ORDER)

    def test_what_is_only_in_some_conditions_counts_by_its_repeats(self) -> None:
        """One condition with noise of 1 and one with noise of 3, as often: 5 is the mean variance; a single run says nothing."""
        rng = np.random.default_rng(10)
        groups = [[size * rng.normal(size=(ROWS, 1)) for _ in range(REPEATS)] for size in (1.0, 3.0)]
        w = whitening([*groups, [1e3 * rng.normal(size=(ROWS, 1))]], np.zeros(1))
        # the wider one has 9 of 10 parts of the variance
        assert w.deviation == pytest.approx([math.sqrt(5.0)], rel=chance(0.5 * 0.9 * of_variance(FREE)))


class TestFast:
    def test_of_what_does_not_change_or_changes_steadily_nothing_is_fast(self) -> None:
        t = np.arange(100.0)[:, None]
        assert fast(np.full((100, 1), 4.0)) == pytest.approx(np.zeros((100, 1)), abs=ROUNDOFF)
        assert fast(3.0 * t - 7.0)[5:-5] == pytest.approx(np.zeros((90, 1)), abs=1e3 * ROUNDOFF)

    def test_what_alternates_is_fast_but_for_a_fifth(self) -> None:
        """The mean of five is a fifth of it; white noise loses a fifth of its variance, which is made up for."""
        x = (-1.0) ** np.arange(60)[:, None]
        assert fast(x)[2:-2] == pytest.approx(0.8 / math.sqrt(0.8) * x[2:-2], rel=ROUNDOFF)

    def test_an_impulse_keeps_its_energy(self) -> None:
        x = np.zeros((50, 1))
        x[20] = 3.0
        assert float(np.sum(fast(x) ** 2)) == pytest.approx(9.0, rel=ROUNDOFF)


class TestGuessed:
    def test_without_repeats_white_noise_is_found_under_what_is_slow(self) -> None:
        rng = np.random.default_rng(11)
        slow = 30.0 * np.sin(np.arange(ROWS) / 3000.0)[:, None]
        w = whitening([[slow + rng.normal(size=(ROWS, 1))]], np.zeros(1))
        assert w.guessed
        # the fast part is correlated: 0.8^2 + 2 * (0.3^2 + 0.2^2 + ...) of its squares is 1.25 of those of white noise
        assert w.deviation == pytest.approx([1.0], rel=chance(0.5 * of_variance(ROWS / 1.25)))


class TestOwnNoise:
    ROWS = 1000

    def groups(self, shape: FloatArray, channel: int = 1, channels: int = 3) -> list[list[FloatArray]]:
        """Two repeats of a condition that are apart by twice this in one channel, and a single one of another."""
        x = np.zeros((self.ROWS, channels))
        x[:, channel] = shape
        return [[x.ravel(), -x.ravel()], [np.ones(self.ROWS * channels)]]

    def test_an_offset_that_scatters_by_more_than_noise_is_a_column_of_the_excess(self) -> None:
        """Offsets of +-o: variance 2 o^2 rows in the constant of unit length; too little in spells of a tenth to be rare."""
        o = math.sqrt(9.0 / (2.0 * self.ROWS))
        assert RARE > 0.1 * 9.0
        columns = own_noise(self.groups(np.full(self.ROWS, o)), 3, self.ROWS // 10)
        assert columns.shape == (3 * self.ROWS, 1)
        expected = np.zeros((self.ROWS, 3))
        expected[:, 1] = math.sqrt(9.0 - 1.0) / math.sqrt(self.ROWS)
        assert columns[:, 0] == pytest.approx(expected.ravel(), rel=1e2 * ROUNDOFF, abs=1e2 * ROUNDOFF)

    def test_a_spell_that_scatters_is_a_box(self) -> None:
        """The variance of the spell is 2 s^2 times its length, here 50: the cosines have their parts of it, too."""
        length = self.ROWS // 10
        box = np.zeros(self.ROWS)
        box[3 * length : 4 * length] = math.sqrt(50.0 / (2.0 * length))
        columns = own_noise(self.groups(box), 3, length)
        expected = np.zeros((self.ROWS, 3))
        expected[3 * length : 4 * length, 1] = math.sqrt(50.0 - 1.0) / math.sqrt(length)
        same = [c for c in columns.T if np.count_nonzero(c) == length]
        assert len(same) == 1
        assert same[0] == pytest.approx(expected.ravel(), rel=1e2 * ROUNDOFF)

    def test_with_noise_and_own_noise_the_columns_are_what_white_noise_lacks(self) -> None:
        """I + B B', B the columns, has the variance in the direction of the offset that the repeats have."""
        rng = np.random.default_rng(12)
        constant = np.full(self.ROWS, 1.0 / math.sqrt(self.ROWS))
        # in a spell of a tenth 1 + 0.9, which is not rare
        runs = [rng.normal(size=self.ROWS) + 3.0 * rng.normal() * constant for _ in range(400)]
        columns = own_noise([runs], 1, self.ROWS // 10)
        expected = 1.0 + 9.0
        found = 1.0 + float(np.sum((constant @ columns) ** 2))
        assert found == pytest.approx(expected, rel=chance(of_variance(399)))

    def test_what_was_measured_once_has_no_columns(self) -> None:
        assert own_noise([[np.ones(30)], [np.ones(30)]], 3, 5).shape == (30, 0)

    def test_repeats_that_scatter_less_than_noise_have_none(self) -> None:
        quiet = [0.1 * np.random.default_rng(k).normal(size=300) for k in range(5)]
        assert own_noise([quiet], 1, 30).shape == (300, 0)


class TestChannelsThatAConditionLacks:
    BOTH, FIRST = np.array([True, True]), np.array([True, False])

    def groups(self, seed: int = 3) -> tuple[list[FloatArray], list[FloatArray]]:
        """Repeats of two conditions with noise that both channels share; the second condition lacks the second channel."""
        rng = np.random.default_rng(seed)
        mixed = np.array([[1.0, 0.0], [0.9, 0.4]])
        one = [rng.normal(size=(2000, 2)) @ mixed.T for _ in range(4)]
        return one, [rng.normal(size=(2000, 2)) @ mixed.T * self.FIRST for _ in range(4)]

    def test_noise_is_that_of_the_conditions_that_have_the_channel(self) -> None:
        one, other = self.groups()
        floor = np.full(2, 1e-6)
        found = whitening([one, other], floor, there=[self.BOTH, self.FIRST])
        alone = whitening([one], floor)
        assert found.deviation[1] == pytest.approx(alone.deviation[1], rel=ROUNDOFF)
        own = [np.sqrt((w.factor @ w.factor.T)[1, 1]) for w in (found, alone)]
        assert own[0] == pytest.approx(own[1], rel=ROUNDOFF)

    def test_what_is_not_measured_says_nothing_of_what_is(self) -> None:
        """As if the other channel were alone: zero is no measured value that goes against what both have in common."""
        one, other = self.groups()
        both = whitening([one, other], np.full(2, 1e-6), there=[self.BOTH, self.FIRST])
        single = Whitening(both.coefficients[:1], np.sqrt((both.factor @ both.factor.T)[:1, :1]), both.deviation[:1], False)
        white = both.apply(other[0], 1.0, there=self.FIRST).reshape(-1, 2)
        assert np.all(white[:, 1] == 0.0)
        assert white[:, 0] == pytest.approx(single.apply(other[0][:, :1]), rel=1e3 * ROUNDOFF, abs=1e3 * ROUNDOFF)

    def test_a_channel_that_was_never_repeated_is_guessed_and_the_others_are_not(self) -> None:
        rng = np.random.default_rng(4)
        repeated = [rng.normal(size=(3000, 2)) * self.FIRST for _ in range(4)]
        once = [np.stack([rng.normal(size=3000), 3.0 * rng.normal(size=3000)], axis=1)]
        found = whitening([repeated, once], np.full(2, 1e-6), there=[self.FIRST, self.BOTH])
        assert not found.guessed
        # a deviation from n samples scatters by 1 / sqrt(2 n), relative; of fast parts, which go with each other, by less than twice that
        assert found.deviation == pytest.approx([1.0, 3.0], rel=chance(2.0 * math.sqrt(0.5 / 3000)))
        without = whitening([repeated], np.full(2, 1e-6), there=[self.FIRST])
        assert found.deviation[0] == pytest.approx(without.deviation[0], rel=ROUNDOFF)


def test_the_memory_of_noise_is_that_of_the_time_series_beside_independent_samples() -> None:
    """With the independent ones it would be less by the root of two."""
    rng = np.random.default_rng(12)
    series = [autoregressive(rng, 0.8)[:, None] for _ in range(REPEATS)]
    apart = [rng.normal(size=(ROWS, 1)) for _ in range(REPEATS)]
    both = whitening([series, apart], np.zeros(1), independent=[False, True])
    alone = whitening([series], np.zeros(1))
    assert both.coefficients == pytest.approx(alone.coefficients, rel=1e3 * ROUNDOFF)
    x = rng.normal(size=(ROWS, 1))
    assert both.of(True).apply(x) == pytest.approx(x[:, 0] / both.factor[0, 0], rel=ROUNDOFF)
    assert both.of(False) is both
