"""Fits and evidence against the closed forms of linear models with normal noise, and against integrals over the priors."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import dblquad, quad
from scipy.stats import multivariate_normal

from robomill.diagnosis.candidates import Candidate, Prior
from robomill.diagnosis.inference.estimation import FORM_ERROR, Fit, Model, Space, leave_one_out, quadratic_fit, solved
from robomill.orchestration.slaves.protocol import FloatArray
from tests.tolerances import EXACT, ROUNDOFF, discretisation

N = 60
BLOCKS = {"first": slice(0, 25), "second": slice(25, 45), "third": slice(45, N)}
INVERTED = 1e3 * ROUNDOFF
"""Relative: two ways to invert matrices whose condition is below a thousand."""
SETTLED = 1e-9
"""Relative: ten times the change below which the coordinates of a fit are taken as settled."""
INTEGRATED = discretisation(0.97 / 12.0, 0.1, 2)
"""Log of evidence: the trapezoidal rule at 0.1 deviations of a normal density, of which the integral of |f''| is 0.97 per variance."""


def candidate(name: str = "a", effect: str = "effect", kind: str = "normal", scale: float = 0.2, locations: int = 1) -> Candidate:
    return Candidate(effect, "part", name, (name,), 0.001, 1e3 * scale, Prior(kind, scale, 0.7), "1", kind == "normal", locations)


def made(seed: int = 1, nuisances: int = 3) -> Space:
    """A residual that nuisances and something else are in."""
    rng = np.random.default_rng(seed)
    B = rng.normal(size=(N, nuisances)) * np.linspace(0.2, 3.0, nuisances)
    return Space(rng.normal(size=N) + B @ rng.normal(size=nuisances), BLOCKS, B, [("part", f"n{i}") for i in range(nuisances)])


def dense(space: Space) -> FloatArray:
    """The nuisances B [n, m], which the space keeps by condition."""
    return np.asarray(space.nuisances.toarray())


def covariance(B: FloatArray) -> FloatArray:
    return np.eye(len(B)) + B @ B.T


def inverse(B: FloatArray) -> FloatArray:
    return np.linalg.inv(covariance(B))


def log_density(y: FloatArray, *columns: FloatArray) -> float:
    """Log of that of noise and columns whose sizes are normal with deviation 1."""
    return float(multivariate_normal(np.zeros(len(y)), covariance(np.column_stack(columns))).logpdf(y))


class TestSpace:
    def test_the_inner_product_is_that_of_the_covariance_with_the_nuisances(self) -> None:
        space = made()
        rng = np.random.default_rng(2)
        u, V = rng.normal(size=N), rng.normal(size=(N, 4))
        C = inverse(dense(space))
        assert space.dot(u, u) == pytest.approx(u @ C @ u, rel=INVERTED)
        assert space.dot(V, u) == pytest.approx(V.T @ C @ u, rel=INVERTED)
        assert space.dot(V, V) == pytest.approx(V.T @ C @ V, rel=INVERTED, abs=INVERTED * N)
        assert space.chi2_of(V) == pytest.approx(np.diag(V.T @ C @ V), rel=INVERTED)
        assert space.within(space.gram(V), [2, 0]) == pytest.approx((V.T @ C @ V)[np.ix_([2, 0], [2, 0])], rel=INVERTED, abs=INVERTED * N)
        assert space.log_determinant == pytest.approx(np.linalg.slogdet(covariance(dense(space)))[1], rel=INVERTED)

    def test_without_nuisances_it_is_the_plain_one(self) -> None:
        space = made(nuisances=0)
        assert space.dot(space.y, space.y) == pytest.approx(space.y @ space.y, rel=ROUNDOFF)
        assert space.log_determinant == EXACT

    def test_nuisances_are_moved_to_their_mean_after_the_data(self) -> None:
        """The normal equations of a ridge of 1; what they explain and what is left of a residual go into the inner product."""
        space = made()
        B, y = dense(space), space.y
        ridge = np.linalg.lstsq(np.vstack([B, np.eye(3)]), np.append(y, np.zeros(3)), rcond=None)[0]
        assert space.moved(y) == pytest.approx(ridge, rel=INVERTED)
        assert space.explained(y) == pytest.approx(B @ ridge, rel=INVERTED, abs=INVERTED)
        left = y - B @ ridge
        assert space.dot(y, y) == pytest.approx(left @ left + ridge @ ridge, rel=INVERTED)

    def test_a_part_of_the_data_has_its_own_covariance(self) -> None:
        space = made()
        rows = np.r_[25:45, 0:25]
        part = space.only(["second", "first"])
        assert np.array_equal(space.rows(["second", "first"]), rows)
        assert part.dot(part.y, part.y) == pytest.approx(space.y[rows] @ inverse(dense(space)[rows]) @ space.y[rows], rel=INVERTED)

    def test_nuisances_that_are_the_same_as_a_parameter_do_not_count_beside_it(self) -> None:
        """Known by their name or by their column; their deviation in its unit is the length of theirs over that of its own."""
        space = made()
        B = dense(space)
        rng = np.random.default_rng(3)
        other = rng.normal(size=N)
        addresses = {("part", "n0"): other, ("part", "like n1"): -4.0 * B[:, 1] + 0.01 * other, ("part", "like none"): other}
        space.find_alike(addresses, dict.fromkeys(addresses, 0.5))
        assert [set(space.alike[a]) for a in addresses] == [{("part", "n0")}, {("part", "n1")}, set()]
        assert space.alike["part", "like n1"]["part", "n1"] == pytest.approx(
            0.5 / 4.0, rel=0.01 * abs(other @ B[:, 1]) / (B[:, 1] @ B[:, 1])
        )
        for gone, a in ((0, ("part", "n0")), (1, ("part", "like n1"))):
            rest = np.delete(B, gone, axis=1)
            own = space.without([a])
            assert own.dot(other, space.y) == pytest.approx(other @ inverse(rest) @ space.y, rel=INVERTED)
            assert own.log_determinant == pytest.approx(np.linalg.slogdet(covariance(rest))[1], rel=INVERTED)
            less = space.less([("part", f"n{gone}")])
            assert less.dot(other, space.y) == pytest.approx(own.dot(other, space.y), rel=INVERTED)
            # the products of columns that are known serve it, too
            both = np.column_stack([other, space.y])
            assert own.within(space.gram(both), [0, 1]) == pytest.approx(own.dot(both, both), rel=INVERTED)
        assert space.without([("part", "like none")]) is space

    @pytest.mark.parametrize("k", [1, 4])
    def test_widened_by_more_nuisances_it_is_that_of_their_covariance_together(self, k: int) -> None:
        space = made()
        rng = np.random.default_rng(6)
        more, u, V = rng.normal(size=(N, k)), rng.normal(size=N), rng.normal(size=(N, 2))
        wide, together = space.widened(more), np.column_stack([dense(space), more])
        C = inverse(together)
        assert wide.dot(u, space.y) == pytest.approx(u @ C @ space.y, rel=INVERTED)
        assert wide.within(wide.gram(V), [0, 1]) == pytest.approx(V.T @ C @ V, rel=INVERTED)
        assert wide.chi2 == pytest.approx(space.y @ C @ space.y, rel=INVERTED)
        assert wide.log_determinant == pytest.approx(np.linalg.slogdet(covariance(together))[1], rel=INVERTED)
        assert wide.names == (*space.names, *[FORM_ERROR] * k)
        rows = wide.rows(["second"])
        part = wide.only(["second"])
        assert part.dot(part.y, part.y) == pytest.approx(space.y[rows] @ inverse(together[rows]) @ space.y[rows], rel=INVERTED)

    @pytest.mark.parametrize("k", [0, 2])
    def test_products_of_columns_beside_known_ones_are_those_of_all_together(self, k: int) -> None:
        """Known products are those of the space that this one is widened from, too."""
        space = made()
        rng = np.random.default_rng(4)
        V, more = rng.normal(size=(N, 3)), rng.normal(size=(N, 2))
        wide = space.widened(rng.normal(size=(N, k)))
        found = wide.within(wide.beside(space.gram(V), V, more), range(5))
        together = np.column_stack([V, more])
        assert found == pytest.approx(wide.dot(together, together), rel=INVERTED, abs=INVERTED)

    def test_widened_it_keeps_what_is_out_and_what_is_alike(self) -> None:
        """An effect that a nuisance is like, in a model whose law may be off: the nuisance goes, what the law misses stays."""
        space = made()
        a, other = ("part", "n1"), np.random.default_rng(7).normal(size=(N, 2))
        space.find_alike({a: dense(space)[:, 1]}, {a: 0.2})
        rest = np.column_stack([np.delete(dense(space), 1, axis=1), other])
        for own in (space.without([a]).widened(other), space.widened(other).without([a])):
            assert own.dot(space.y, space.y) == pytest.approx(space.y @ inverse(rest) @ space.y, rel=INVERTED)
            assert own.log_determinant == pytest.approx(np.linalg.slogdet(covariance(rest))[1], rel=INVERTED)
        assert space.widened(None) is space
        assert space.widened(np.zeros((N, 0))) is space


def fitted(model: Model, s: FloatArray, space: Space, start: FloatArray | None = None) -> Fit:
    """Fit of a signature that is proportional to the parameters, from anywhere."""
    at = np.zeros(s.shape[1]) if start is None else start
    return quadratic_fit(model, s @ at, s, at, space)


def signatures(k: int, size: float = 0.3, seed: int = 4) -> FloatArray:
    return size * np.random.default_rng(seed).normal(size=(N, k))


class TestNormalPriors:
    """y = S x + B b + e with x, b and e normal: everything has a closed form."""

    @pytest.mark.parametrize("k", [1, 2, 3])
    @pytest.mark.parametrize("nuisances", [0, 3])
    @pytest.mark.parametrize("size", [0.02, 0.3, 3.0])
    def test_evidence_is_that_of_the_normal_distribution_of_the_data(self, k: int, nuisances: int, size: float) -> None:
        space, s = made(nuisances=nuisances), signatures(k, size)
        fit = fitted(tuple(candidate(f"p{i}") for i in range(k)), s, space)
        expected = log_density(space.y, dense(space), s) - log_density(space.y, dense(space))
        assert fit.log_evidence == pytest.approx(expected, abs=INTEGRATED if k == 1 else SETTLED * N * max(1.0, abs(expected)))

    @pytest.mark.parametrize("k", [1, 3])
    def test_values_and_deviations_are_those_after_the_data(self, k: int) -> None:
        space, s = made(), signatures(k)
        model = tuple(candidate(f"p{i}", scale=0.2 * (i + 1)) for i in range(k))
        scales = 0.2 * np.arange(1, k + 1)
        precision = np.eye(k) + s.T @ inverse(dense(space)) @ s
        mean = np.linalg.solve(precision, s.T @ inverse(dense(space)) @ space.y)
        for start in (None, np.full(k, 2.5)):
            fit = fitted(model, s, space, start)
            assert list(fit.values) == [("part", f"p{i}") for i in range(k)]
            assert [*fit.values.values()] == pytest.approx(mean * scales, rel=SETTLED, abs=SETTLED)
            assert [*fit.deviations.values()] == pytest.approx(np.sqrt(np.diag(np.linalg.inv(precision))) * scales, rel=INVERTED)

    def test_what_remains_is_the_residual_at_the_best_values(self) -> None:
        space, s = made(), signatures(2)
        model = (candidate("p0"), candidate("p1"))
        fit = fitted(model, s, space)
        left = space.y - s @ (np.array([*fit.values.values()]) / 0.2)
        products = np.column_stack([s, space.y])
        again = solved(model, space.dot(products, products), space, space)
        assert again.log_evidence == pytest.approx(fit.log_evidence, rel=INVERTED)
        gain = 0.5 * (space.dot(space.y, space.y) - space.dot(left, left))
        # evidence is the gain at the best values less what the priors and the determinant take
        x = np.array([*fit.values.values()]) / 0.2
        precision = np.eye(2) + s.T @ inverse(dense(space)) @ s
        assert fit.log_evidence == pytest.approx(gain - 0.5 * x @ x - 0.5 * np.linalg.slogdet(precision)[1], rel=SETTLED)

    def test_a_nuisance_that_is_the_same_is_taken_out_of_the_model_that_has_it_as_an_effect(self) -> None:
        """Against the nominal model, which keeps it as a nuisance."""
        space = made()
        s = 5.0 * dense(space)[:, [2]]
        effect = candidate("tolerated")
        space.find_alike({effect.addresses[0]: s[:, 0]}, {effect.addresses[0]: 0.2})
        expected = log_density(space.y, dense(space)[:, :2], s) - log_density(space.y, dense(space))
        assert fitted((effect,), s, space).log_evidence == pytest.approx(expected, abs=INTEGRATED)

    def test_what_a_law_may_miss_is_paid_for_by_the_model_that_has_it(self) -> None:
        """Form columns are nuisances of this model alone: its evidence is against the nominal model without them."""
        space, s = made(), signatures(2, 1.0)
        form = 0.3 * np.column_stack([s[:, 0] * (np.arange(N) < 25), s[:, 1] * (np.arange(N) >= 25)])
        model = (candidate("p0"), candidate("p1"))
        fit = quadratic_fit(model, 0.0 * space.y, s, np.zeros(2), space, form)
        expected = log_density(space.y, dense(space), form, s) - log_density(space.y, dense(space))
        assert fit.log_evidence == pytest.approx(expected, abs=SETTLED * N * max(1.0, abs(expected)))
        precision = np.eye(2) + s.T @ inverse(np.column_stack([dense(space), form])) @ s
        widths = np.array([*fit.deviations.values()]) / 0.2
        assert widths == pytest.approx(np.sqrt(np.diag(np.linalg.inv(precision))), rel=INVERTED)
        plain = quadratic_fit(model, 0.0 * space.y, s, np.zeros(2), space)
        assert np.all(widths > np.array([*plain.deviations.values()]) / 0.2)

    def test_a_value_stays_within_its_bounds_and_the_others_are_fitted_beside_it(self) -> None:
        """The first wants to be 3 and may be 1: the second is the best one for that."""
        bounded = Candidate("effect", "part", "p0", ("p0",), 0.001, 0.2, Prior("normal", 0.2), "1", True, 1)
        s = signatures(2)
        s[:, 1] += s[:, 0]  # what one cannot do the other does a part of
        space = Space(s @ [3.0, 0.5], BLOCKS, np.zeros((N, 0)))
        x = np.array([*fitted((bounded, candidate("p1")), s, space).values.values()]) / 0.2
        left = space.y - s[:, 0]
        assert x == pytest.approx([1.0, s[:, 1] @ left / (s[:, 1] @ s[:, 1] + 1.0)], rel=SETTLED)


class TestLogNormalPriors:
    """No closed form: integrals over the prior."""

    @staticmethod
    def prior(u: float, spread: float = 0.7) -> float:
        """Density of x, of which the logarithm is normal, per prior scale."""
        return math.exp(-0.5 * (math.log(u) / spread) ** 2) / (u * spread * math.sqrt(2.0 * math.pi)) if u > 0.0 else 0.0

    @pytest.mark.parametrize("size", [0.005, 0.05, 0.5, 5.0])
    @pytest.mark.parametrize("truth", [0.0, 0.3, 2.0])
    def test_evidence_of_one_is_the_integral_over_its_prior(self, size: float, truth: float) -> None:
        s = signatures(1, size)
        space = Space(made().y * 0.5 + truth * s[:, 0], BLOCKS, dense(made()))
        hessian, gradient = (float(s[:, 0] @ inverse(dense(space)) @ v) for v in (s[:, 0], space.y))
        best, deviation = gradient / hessian, 1.0 / math.sqrt(1.0 + hessian)

        def relative(u: float) -> float:
            """Likelihood over its largest one, times the prior."""
            return math.exp(-0.5 * hessian * (u - best) ** 2) * self.prior(u)

        about = {*np.clip(best + deviation * np.arange(-6.0, 7.0), 1e-6, 900.0).tolist(), 0.2, 1.0, 5.0}
        expected = 0.5 * gradient**2 / hessian + math.log(quad(relative, 0.0, 1000.0, points=sorted(about), limit=500)[0])
        fit = fitted((candidate(kind="log-normal"),), s, space)
        assert fit.log_evidence == pytest.approx(expected, abs=INTEGRATED)

    @pytest.mark.parametrize("kinds", [("normal", "log-normal"), ("log-normal", "log-normal")])
    def test_evidence_of_two_is_the_integral_where_the_data_say_how_large_they_are(self, kinds: tuple[str, str]) -> None:
        """Laplace's approximation: priors are straight lines over the 0.02 scales that the data leave, but for terms of second order."""
        s = 6.0 * signatures(2, 1.0)
        truth = np.array([-0.8, 0.6]) if kinds[0] == "normal" else np.array([1.5, 0.6])
        space = Space(made().y * 0.5 + s @ truth, BLOCKS, dense(made()))
        fit = fitted((candidate("p0", kind=kinds[0]), candidate("p1", kind=kinds[1])), s, space)
        x, width = np.array([*fit.values.values()]) / 0.2, np.array([*fit.deviations.values()]) / 0.2
        densities = [self.prior if kind == "log-normal" else lambda u: math.exp(-0.5 * u * u) / math.sqrt(2.0 * math.pi) for kind in kinds]
        hessian = s.T @ inverse(dense(space)) @ s
        gradient = s.T @ inverse(dense(space)) @ space.y

        def relative(v: float, u: float) -> float:
            """Likelihood over that at the best values, times priors."""
            away = np.array([u, v]) - x
            return math.exp(float((gradient - hessian @ x) @ away - 0.5 * away @ hessian @ away)) * densities[0](u) * densities[1](v)

        box = [(float(c - 8.0 * w), float(c + 8.0 * w)) for c, w in zip(x, width, strict=True)]
        integral = dblquad(relative, *box[0], *box[1], epsabs=0.0, epsrel=INTEGRATED * 1e-2)[0]
        expected = float(gradient @ x - 0.5 * x @ hessian @ x) + math.log(integral)
        # slope of the log of a density at 0.6 scales, -3, times a shift of the best value, and half of its curvature: of the variance
        assert width.max() < 0.05
        assert fit.log_evidence == pytest.approx(expected, abs=discretisation(10.0, float(width.max()), 2))


class TestLeaveOneOut:
    def fit(self, space: Space, s: FloatArray) -> Fit:
        fit = fitted(tuple(candidate(f"p{i}") for i in range(s.shape[1])), s, space)
        fit.signature = s @ (np.array([*fit.values.values()]) / 0.2)
        # the slopes, whatever they are called
        return Fit(fit.model, fit.values, fit.deviations, fit.log_evidence, 0.0, fit.signature, s)

    @pytest.mark.parametrize("nuisances", [0, 3])
    def test_each_part_is_scored_with_the_values_that_the_others_give(self, nuisances: int) -> None:
        s, space = signatures(2), made(nuisances=nuisances)
        fit = self.fit(space, s)
        best = np.array([*fit.values.values()]) / 0.2
        found = leave_one_out(fit, space)
        assert set(found) == set(BLOCKS)
        for name, block in BLOCKS.items():
            rest = np.delete(np.arange(N), np.arange(N)[block])
            C, D = inverse(dense(space)[rest]), inverse(dense(space)[block])
            x = np.linalg.solve(s[rest].T @ C @ s[rest] + np.eye(2), s[rest].T @ C @ space.y[rest])
            before = space.y[block] @ D @ space.y[block]
            for score, values in ((found[name].predicted, x), (found[name].fitted, best)):
                left = space.y[block] - s[block] @ values
                assert score == pytest.approx(0.5 * (before - left @ D @ left), rel=SETTLED, abs=SETTLED * before)

    def test_what_shows_in_one_part_only_is_not_predicted_by_the_others(self) -> None:
        s = signatures(1, 3.0)
        s[25:] = 0.0
        space = Space(s[:, 0] + np.random.default_rng(5).normal(size=N), BLOCKS, np.zeros((N, 0)))
        found = leave_one_out(self.fit(space, s), space)
        assert found["first"].predicted == pytest.approx(0.0, abs=INVERTED)  # with nothing known it is as the prior has it
        assert found["first"].fitted > 10.0

    def test_one_part_has_no_others(self) -> None:
        s, space = signatures(1), Space(made().y, {"all": slice(0, N)}, dense(made()))
        assert leave_one_out(self.fit(space, s), space) == {}
