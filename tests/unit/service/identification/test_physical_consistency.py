"""Physical by construction, equal to the base parameters where that can be, as near as can be where it cannot."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from service import BadInput
from service.identification.model.base_parameters import base_parameters
from service.identification.model.physical_consistency import (
    NearestPhysical,
    SearchEnded,
    _Constraints,  # pyright: ignore[reportPrivateUsage]  what it does at the end of the numbers is seen nowhere else
    is_physical,
    nearest_physical,
    pseudo_inertia,
)
from service.model import Chain, read_chain
from tests.random_chain import random_urdf

pytestmark = pytest.mark.slow

SEEDS = st.integers(0, 2**32 - 1)
FEW = settings(max_examples=25, deadline=None, derandomize=True)
POINT = np.array([[2.0, 0, 0, 1.0, 0, 0, 0, 0, 0, 0]])  # 2 kg somewhere, without extent


def random_parameters(rng: np.random.Generator, count: int) -> np.ndarray:
    """(11 count,) of a robot that could be built: links over three decades of mass, motors over two."""
    factors = rng.normal(size=(count, 4, 6)) * np.array([0.5, 0.3, 0.4, 1.0])[:, None]
    pseudo = 10 ** rng.uniform(-1, 2, (count, 1, 1)) * factors @ np.swapaxes(factors, 1, 2)
    second = pseudo[:, :3, :3]
    inertia = np.trace(second, axis1=1, axis2=2)[:, None, None] * np.eye(3) - second
    links = np.concatenate([pseudo[:, 3:, 3], pseudo[:, 3, :3], inertia[:, [0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]], 1)
    return np.concatenate([links.ravel(), 10 ** rng.uniform(-1, 1, count)])


def robot(seed: int) -> tuple[np.random.Generator, Chain, np.ndarray, np.ndarray]:
    """A chain of 1 to 4 joints, its combination K (r, 11 n), and its nominal parameters."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 5))
    chain = read_chain(random_urdf(rng, count))
    nominal = np.concatenate([chain.inertial.ravel(), rng.uniform(1, 50, count)])
    return rng, chain, base_parameters(chain, tuple(range(count))).combination, nominal


def nearest(nominal: np.ndarray, rows: np.ndarray, values: np.ndarray, covariance: np.ndarray) -> NearestPhysical:
    return nearest_physical(nominal, (0.3, np.full(len(nominal) // 11, 0.1)), rows, values, covariance)


def cost(parameters: np.ndarray, nominal: np.ndarray) -> float:
    """Weighted divergence from the nominal model, by its definition."""
    count = len(parameters) // 11
    ratio = np.linalg.solve(
        pseudo_inertia(nominal[: 10 * count].reshape(-1, 10)), pseudo_inertia(parameters[: 10 * count].reshape(-1, 10))
    )
    links = np.trace(ratio, axis1=1, axis2=2) - np.linalg.slogdet(ratio)[1] - 4
    motors = parameters[10 * count :] / nominal[10 * count :]
    return float(links.sum() / (4 * 0.3**2) + (motors - np.log(motors) - 1).sum() / 0.1**2)


def buildable(parameters: np.ndarray) -> bool:
    """Mass, triangle inequalities and positive moments of each link about its centre of mass; motors."""
    count = len(parameters) // 11
    links = parameters[: 10 * count].reshape(-1, 10)
    for link in links:
        centre = link[1:4] / link[0]
        xx, xy, yy, xz, yz, zz = link[4:]
        about = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        about -= link[0] * (centre @ centre * np.eye(3) - np.outer(centre, centre))
        small, middle, large = np.linalg.eigvalsh(about)
        if not (link[0] > 0 and small > 0 and small + middle > large):
            return False
    return bool(is_physical(links).all() and (parameters[10 * count :] > 0).all())


@FEW
@given(SEEDS)
def test_what_a_real_robot_has_comes_back_exactly(seed: int) -> None:
    rng, _, rows, nominal = robot(seed)
    values = rows @ random_parameters(rng, len(nominal) // 11)
    found = nearest(nominal, rows, values, np.diag((0.01 * values) ** 2))
    assert buildable(found.parameters)
    assert (found.ended, found.deviation) == (SearchEnded.EXACT, 0)
    size = np.abs(rows) @ np.abs(found.parameters)  # terms that cancel leave rounding of this size
    np.testing.assert_allclose(rows @ found.parameters, values, rtol=1e-9, atol=1e-11 * size.max())


@pytest.mark.slow
@FEW
@given(SEEDS, st.floats(0.01, 3))
def test_what_noise_made_impossible_comes_back_physical(seed: int, noise: float) -> None:
    rng, _, rows, nominal = robot(seed)
    truth = random_parameters(rng, len(nominal) // 11)
    sigma = noise * np.abs(rows @ truth) + 1e-3
    values = rows @ truth + sigma * rng.normal(size=len(sigma))
    found = nearest(nominal, rows, values, np.diag(sigma**2))
    assert buildable(found.parameters)
    distance = np.linalg.norm((rows @ found.parameters - values) / sigma)
    assert found.deviation == pytest.approx(distance, rel=1e-6, abs=1e-6)
    # they are more probable than the truth, which is physical too
    away = np.linalg.norm((rows @ truth - values) / sigma)
    bound = cost(truth, nominal) + away**2 / 2
    assert found.deviation == 0 or cost(found.parameters, nominal) + found.deviation**2 / 2 <= bound + 1e-9


def test_the_nominal_model_stays_where_nothing_contradicts_it() -> None:
    _, _, rows, nominal = robot(3)
    found = nearest(nominal, rows, rows @ nominal, np.eye(len(rows)))
    np.testing.assert_allclose(found.parameters, nominal, rtol=1e-9, atol=1e-9 * np.abs(nominal).max())


def test_a_link_scaled_as_a_whole_is_the_cheapest_change() -> None:
    """One link turning about z, no motor: Izz is 20 % more than nominal."""
    nominal = np.array([10.0, 0, 0, 0, 0.3, 0, 0.4, 0, 0, 0.5, 0.0])
    rows = np.eye(11)[9:10]
    found = nearest(nominal, rows, np.array([0.6]), np.eye(1))
    # in closed form: P = (P0^-1 + nu E)^-1; xx and yy of the second moment carry Izz, m and zz stay
    assert found.parameters[9] == pytest.approx(0.6, rel=1e-12)
    assert found.parameters[0] == pytest.approx(10.0)
    xx, yy = (0.4 + 0.5 - 0.3) / 2, (0.3 + 0.5 - 0.4) / 2
    moments = pseudo_inertia(found.parameters[:10])
    assert 1 / moments[0, 0] - 1 / xx == pytest.approx(1 / moments[1, 1] - 1 / yy)
    assert found.parameters[10] == 0.0  # a motor that is not there stays so


def test_an_impossible_value_is_weighed_against_the_model() -> None:
    """Izz = -1 with a standard deviation of 0.5."""
    nominal = np.array([10.0, 0, 0, 0, 0.3, 0, 0.4, 0, 0, 0.5, 0.0])
    found = nearest(nominal, np.eye(11)[9:10], np.array([-1.0]), np.array([[0.25]]))
    assert is_physical(found.parameters[:10])
    assert found.ended is SearchEnded.MOST_PROBABLE
    assert found.deviation == pytest.approx((found.parameters[9] + 1) / 0.5)
    # Izz is the sum of two second moments; at the minimum the slopes of both terms of the cost cancel, for each of them
    nominal_moments, moments = pseudo_inertia(nominal[:10]), pseudo_inertia(found.parameters[:10])
    for k in (0, 1):
        slope = (1 / nominal_moments[k, k] - 1 / moments[k, k]) / (4 * 0.3**2)
        assert slope == pytest.approx(-found.deviation / 0.5)


@settings(FEW, max_examples=10)
@given(SEEDS)
def test_values_thousands_of_deviations_away_come_back_physical(seed: int) -> None:
    """What effort of the wrong sign makes: minus the base parameters of a real robot, known well."""
    rng, _, rows, nominal = robot(seed)
    values = -rows @ random_parameters(rng, len(nominal) // 11)
    size = np.abs(rows) @ np.abs(nominal)
    found = nearest(nominal, rows, values, np.diag((1e-3 * size) ** 2))
    assert is_physical(found.parameters[: 10 * len(nominal) // 11].reshape(-1, 10)).all()
    assert (found.parameters[10 * len(nominal) // 11 :] > 0).all()


def test_correlated_noise_counts_by_its_covariance() -> None:
    """The masses of two links, one impossible."""
    nominal = np.concatenate([np.tile([1.0, 0, 0, 0, 0.1, 0, 0.1, 0, 0, 0.1], 2), [0.0, 0.0]])
    covariance, values = np.array([[1.0, 0.8], [0.8, 1.0]]), np.array([-1.0, 5.0])
    found = nearest(nominal, np.eye(22)[[0, 10]], values, covariance)
    mass = found.parameters[[0, 10]]
    assert (mass > 0).all()
    pull = np.linalg.solve(covariance, mass - values)
    np.testing.assert_allclose((1 - 1 / mass) / (4 * 0.3**2), -pull, rtol=1e-9)
    assert found.deviation == pytest.approx(np.sqrt((mass - values) @ pull))


def test_a_nominal_link_that_cannot_be_is_lifted() -> None:
    """A point mass, a massless link, and one that breaks the triangle inequality."""
    broken = np.array([[1.0, 0, 0, 0, 1.0, 0, 1.0, 0, 0, 4.0]])
    nominal = np.concatenate([np.vstack([POINT, np.zeros((1, 10)), broken]).ravel(), np.ones(3)])
    rows = np.eye(33)[[30]]
    found = nearest(nominal, rows, np.array([2.0]), np.eye(1))
    assert buildable(found.parameters)
    assert found.parameters[0] == 2.0
    assert 0 < found.parameters[10] < 1e-5  # of the massless link
    np.testing.assert_allclose(found.parameters[30:], [2.0, 1.0, 1.0])


def test_whether_a_link_is_physical() -> None:
    ball = np.array([[1.0, 0, 0, 0, 0.1, 0, 0.1, 0, 0, 0.1]])
    assert is_physical(ball).all()
    assert not is_physical(POINT).any()
    assert not is_physical(-ball).any()
    assert not is_physical(ball * [1, 1, 1, 1, 1, 1, 1, 1, 1, 2.1]).any()  # 0.1 + 0.1 < 0.21
    far = ball + np.eye(10)[1] * 3  # its centre at 3 m, and no moments about the origin to match
    assert not is_physical(far).any()


@pytest.mark.parametrize("link", [[5e-324, 1.0], [1e308, 1e308], [1e-300, -1e300], [1.0, 1e200]])
def test_numbers_that_overflow_are_not_physical(link: list[float]) -> None:
    parameters = np.array([*link, 0, 0, 1, 0, 1, 0, 0, 1])
    assert not is_physical(parameters)
    assert is_physical(np.array([parameters, [2.0, 0, 0, 0, 1, 0, 1, 0, 0, 1]])).tolist() == [False, True]


@pytest.mark.parametrize("distance", [0.1, 1e3, 1e9, 1e15])
def test_a_nominal_centre_of_mass_may_lie_anywhere(distance: float) -> None:
    """A URDF says where it lies, and rounding left a matrix without a root."""
    nominal = np.array([1.0, -distance, 0, 0, 1, 0, 1, 0, 0, 1, 1.0])
    found = nearest(nominal, np.eye(11)[:1], np.array([5.0]), np.eye(1))
    assert np.isfinite(found.parameters).all()
    assert found.parameters[0] > 0


def test_a_step_that_leaves_the_numbers_leaves_the_domain() -> None:
    """Newton's method tries steps of any length."""
    nominal = np.array([2.0, 0.1, 0, 0, 1, 0, 1, 0, 0, 1, 1.0])
    problem = _Constraints.of(nominal, (0.3, np.array([0.1])), 1e200 * np.eye(11)[:2], np.array([2e200, 1e199]))
    assert problem.inside(np.zeros(2))
    assert not problem.inside(np.array([1e200, -1e200]))


@pytest.mark.parametrize("name", ["nominal model", "rows", "values", "covariance"])
def test_what_is_no_number_is_refused(name: str) -> None:
    _, _, combination, nominal = robot(1)
    values = combination @ nominal
    given = {"nominal model": nominal, "rows": combination, "values": values, "covariance": np.eye(len(values))}
    given[name] = given[name] * np.nan
    with pytest.raises(BadInput, match=rf"^base parameters: \d+ of \d+ values of their {name} are not finite"):
        nearest(*given.values())
