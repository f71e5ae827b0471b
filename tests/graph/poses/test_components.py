"""The restricted likelihood against dense textbook formulas."""

import numpy as np
import pytest
from scipy import optimize, sparse

from handeye_fg.errors import ConvergenceError
from handeye_fg.graph.poses import components
from handeye_fg.graph.poses.chain import ChainRows
from handeye_fg.graph.poses.components import Guess, certainty_of, estimate

BLOCK, SHARED = 3, 4


def problem(seed, n_blocks=6, n_components=3, true=(1.0, 4.0, 0.25)):
    """Each block measured with the shared unknowns, each pair of neighbours without; priors of the shared."""
    rng = np.random.default_rng(seed)
    n_chain = BLOCK * n_blocks
    rows, component = [], []

    def measure(columns, kind, count):
        row = np.zeros((count, n_chain + SHARED))
        row[:, columns] = rng.standard_normal((count, len(columns)))
        rows.append(row)
        component.extend([kind] * count)

    for i in range(n_blocks):
        here, shared = range(BLOCK * i, BLOCK * (i + 1)), range(n_chain, n_chain + SHARED)
        measure([*here, *shared], 0, 4)
        measure([*here, *shared], min(1, n_components - 1), 5)
        if i:
            measure(range(BLOCK * (i - 1), BLOCK * (i + 1)), n_components - 1, 3)
    measure(range(n_chain, n_chain + SHARED), -1, 2)
    component = np.array(component)
    sigma = np.sqrt(np.where(component < 0, 1.0, np.array(true)[component]))
    return ChainRows(
        jacobian=sparse.csr_array(np.vstack(rows)),
        residual=sigma * rng.standard_normal(len(component)),
        component=component,
        n_chain=n_chain,
        block=BLOCK,
        log_variance=1.5,
    )


def row_variances(rows, variances):
    return np.where(rows.component < 0, 1.0, np.asarray(variances)[rows.component])


def dense(rows, variances):
    """Covariance of the unknowns (inverse of the information), P, and the deviance."""
    J, v, r = rows.jacobian.toarray(), row_variances(rows, variances), rows.residual
    covariance = np.linalg.inv(J.T @ (J / v[:, None]))
    P = np.diag(1.0 / v) - (J / v[:, None]) @ covariance @ (J / v[:, None]).T
    deviance = np.log(v).sum() - np.linalg.slogdet(covariance)[1] + r @ P @ r
    return covariance, P, deviance


def guess(*variances, given=False):
    values = np.array(variances)
    return Guess(variances=values, given=np.full(len(values), given))


@pytest.fixture
def without_prior(monkeypatch):
    monkeypatch.setattr(components, "_PRIOR_WEIGHT", 0.0)


@pytest.mark.parametrize("seed", range(5))
def test_deviance_covariance_and_step_are_those_of_dense_algebra(seed):
    rows = problem(seed)
    variances = np.exp(np.random.default_rng(seed).uniform(-3.0, 3.0, 3))
    wanted = [0, 4, rows.n_chain, rows.n_chain + 2]
    found = estimate(rows, guess(*variances, given=True), variances, wanted)
    covariance, _, deviance = dense(rows, variances)
    # Rounding: condition numbers here are below 1e5.
    np.testing.assert_allclose(found.deviance, deviance + 1.5, rtol=1e-10)
    np.testing.assert_allclose(found.covariance, covariance[np.ix_(wanted, wanted)], rtol=1e-8)
    gradient = rows.jacobian.T @ (rows.residual / row_variances(rows, variances))
    np.testing.assert_allclose(found.step, -covariance @ gradient, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(found.variances, variances, rtol=1e-12)


@pytest.mark.parametrize("n_blocks", [1, 2, 6])
def test_the_slope_is_that_of_the_deviance(n_blocks):
    rows = problem(7, n_blocks=n_blocks)
    likelihood = components._Likelihood(rows, guess(0.5, 2.0, 1.0))
    logs = np.array([0.3, -0.8, 0.4])
    # Second differences of a function near 100 with step 1e-4: truncation 1e-8, rounding 1e-10.
    numeric = optimize.approx_fprime(logs, likelihood.penalised, 1e-7)
    np.testing.assert_allclose(likelihood.slope(logs), numeric, atol=1e-4)


def test_the_average_curvature_is_near_the_mean_curvature():
    # Average information = mean of observed and expected; over many draws all three agree. 60 draws
    # of about 40 observations each: relative deviations of 2 / sqrt(2400) = 4 %; bound of four.
    logs = np.log([1.0, 4.0, 0.25])
    step, average, numeric = 1e-4 * np.eye(3), np.zeros((3, 3)), np.zeros((3, 3))
    for seed in range(60):
        likelihood = components._Likelihood(problem(seed), guess(1.0, 4.0, 0.25))
        average += likelihood.average_curvature(logs)
        numeric += [(likelihood.slope(logs + h) - likelihood.slope(logs - h)) / 2e-4 for h in step]
    assert np.abs(average - numeric).max() < 0.16 * np.abs(numeric).max()


@pytest.mark.usefixtures("without_prior")
@pytest.mark.parametrize("seed", range(4))
def test_each_variance_is_its_squares_over_its_redundancy(seed):
    rows = problem(seed)
    found = estimate(rows, guess(1.0, 1.0, 1.0), np.array([0.2, 8.0, 1.0]), [0])
    _, P, _ = dense(rows, found.variances)
    v = row_variances(rows, found.variances)
    residual = v * (P @ rows.residual)  # at the minimum
    redundancy = np.diag(P) * v
    for k, variance in enumerate(found.variances):
        part = rows.component == k
        squares = residual[part] @ residual[part]
        # The search ends at a slope of 0.01: squares / variance = redundancy to 0.01.
        assert squares / variance == pytest.approx(redundancy[part].sum(), abs=0.011)


@pytest.mark.usefixtures("without_prior")
def test_one_component_is_the_usual_variance_with_its_degrees_of_freedom():
    rows = problem(3, n_components=1, true=(2.0,))
    keep = rows.component == 0
    rows = ChainRows(
        jacobian=rows.jacobian[keep],
        residual=rows.residual[keep],
        component=rows.component[keep],
        n_chain=rows.n_chain,
        block=BLOCK,
        log_variance=0.0,
    )
    m, p = rows.jacobian.shape
    wanted = list(range(p - SHARED, p))
    found = estimate(rows, guess(1.0), np.array([30.0]), wanted)
    rest = np.linalg.lstsq(rows.jacobian.toarray(), -rows.residual)[1][0]
    # Slope 0.01 of a curvature m - p = 50.
    assert found.variances[0] == pytest.approx(rest / (m - p), rel=3e-4)
    sure = certainty_of(rows, guess(1.0), found.variances, wanted)
    assert sure.freedom == pytest.approx(m - p, rel=3e-4)
    # One factor of all weights changes no weighting: the t distribution's variance is all.
    f = sure.freedom
    np.testing.assert_allclose(sure.covariance, found.covariance * f / (f - 2.0), rtol=1e-6)


def test_degrees_of_freedom_and_covariance_are_those_of_kenward_and_roger():
    rows = problem(5, n_blocks=3)
    variances, wanted = np.array([1.2, 3.0, 0.3]), list(range(9, 13))
    sure = certainty_of(rows, guess(1.0, 4.0, 0.25), variances, wanted)
    # The same from dense matrices and finite differences in the variances themselves.
    _, P, _ = dense(rows, variances)
    parts = [np.where(rows.component == k, variances[k], 0.0) for k in range(3)]
    vectors = np.array([part * (P @ rows.residual) for part in parts])
    prior = 0.2 * np.array([1.0, 4.0, 0.25]) / variances
    S = 2.0 * np.linalg.inv(vectors @ P @ vectors.T + np.diag(prior))

    def block(v):
        return dense(rows, v)[0][np.ix_(wanted, wanted)]

    h = 1e-3 * np.diag(variances)
    first = [(block(variances + a) - block(variances - a)) / 2e-3 for a in h]
    corrected = block(variances)
    for k, a in enumerate(h):
        for m, b in enumerate(h):
            mixed = block(variances + a + b) - block(variances + a - b)
            mixed += block(variances - a - b) - block(variances - a + b)
            corrected = corrected - S[k, m] * mixed / 4e-6
    inverse = np.linalg.inv(block(variances))
    growth = sum(
        S[k, m] * np.trace(inverse @ first[k] @ inverse @ first[m])
        for k in range(3)
        for m in range(3)
    )
    directions = sum(np.trace(inverse @ part) for part in first)
    freedom = 2.0 * directions / growth
    corrected = corrected + 2.0 / (freedom - 2.0) * sum(first)
    # Differences of relative step 1e-3: truncation 1e-6, rounding 1e-16 / 1e-6 of the largest.
    assert sure.freedom == pytest.approx(freedom, rel=1e-4)
    np.testing.assert_allclose(sure.covariance, corrected, rtol=1e-3, atol=1e-5)


@pytest.mark.simulation
def test_few_rows_give_honest_t_intervals():
    # A mean from two instruments whose variances (1 and 9) are found from 5 readings each: plugging
    # them in gives z squares far above one.
    # t with f above 4 degrees of freedom: the mean of 300 scaled squares has a standard error of
    # sqrt((2 + 6 / (f - 4)) / 300), 0.13 for f = 6; bound of three.
    runs, squares, naive = 300, [], []
    rng = np.random.default_rng(0)
    # The chain is one unknown that only its prior, the last row, measures.
    component = np.append(np.repeat([0, 1], 5), -1)
    jacobian = np.zeros((11, 2))
    jacobian[:10, 1] = jacobian[10, 0] = 1.0
    sigma = np.array([1.0, 3.0, 0.0])[component]
    for _ in range(runs):
        rows = ChainRows(
            jacobian=sparse.csr_array(jacobian),
            residual=sigma * rng.standard_normal(11),
            component=component,
            n_chain=1,
            block=1,
            log_variance=0.0,
        )
        found = estimate(rows, guess(3.0, 3.0), np.array([3.0, 3.0]), [1])
        sure = certainty_of(rows, guess(3.0, 3.0), found.variances, [1])
        squares.append(found.step[1] ** 2 / sure.covariance[0, 0])
        naive.append(found.step[1] ** 2 / found.covariance[0, 0])
    assert np.mean(naive) > 1.3
    assert np.mean(squares) == pytest.approx(1.0, abs=0.4)


def test_given_variances_stay():
    rows = problem(2)
    first = Guess(variances=np.array([1.0, 7.0, 1.0]), given=np.array([False, True, False]))
    found = estimate(rows, first, np.array([1.0, 7.0, 1.0]), [0, 1])
    assert found.variances[1] == pytest.approx(7.0, rel=1e-12)
    assert np.abs(np.log(found.variances[[0, 2]])).min() > 1e-3
    everything = guess(1.0, 7.0, 1.0, given=True)
    sure = certainty_of(rows, everything, everything.variances, [0, 1])
    assert sure.freedom == np.inf
    np.testing.assert_allclose(
        sure.covariance, dense(rows, everything.variances)[0][:2, :2], rtol=1e-8
    )


def test_a_component_without_rows_stays_at_its_guess():
    rows = problem(4, n_components=2, true=(1.0, 1.0))
    found = estimate(rows, guess(1.0, 1.0, 5.0), np.array([1.0, 1.0, 20.0]), [0])
    # Slope 0.01 over the prior's curvature 0.2.
    assert found.variances[2] == pytest.approx(5.0, rel=0.06)


@pytest.mark.parametrize("given", [False, True])
def test_unknowns_that_nothing_measures_are_an_error(given):
    rows = problem(1)
    jacobian = rows.jacobian.toarray()
    jacobian[:, -1] = 0.0
    rows = ChainRows(
        jacobian=sparse.csr_array(jacobian),
        residual=rows.residual,
        component=rows.component,
        n_chain=rows.n_chain,
        block=BLOCK,
        log_variance=0.0,
    )
    with pytest.raises(ConvergenceError, match="do not determine"):
        estimate(rows, guess(1.0, 1.0, 1.0, given=given), np.ones(3), [0])
