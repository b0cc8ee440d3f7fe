import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graphslam import MotionModel, OptionError, SensorModel
from graphslam.se2 import sinc_derivative, wrap

motion, sensor = MotionModel(), SensorModel()
angle = st.floats(-np.pi, np.pi)
position = st.floats(-20, 20)
pose = st.tuples(position, position, angle).map(np.array)
speed = st.floats(-2, 2)
# straight lines and everything near them, where the textbook's formula divides by nothing
turn_rate = st.one_of(st.just(0.0), st.floats(-1e-4, 1e-4), st.floats(-2, 2))
control = st.tuples(speed, turn_rate).map(np.array)
dt = st.floats(0.01, 3)
sighting = st.tuples(st.floats(0.1, 20), angle, angle).map(np.array)


def numeric(function, x, step=1e-6):
    columns = []
    for k in range(len(x)):
        d = np.zeros(len(x))
        d[k] = step
        difference = function(x + d) - function(x - d)
        columns.append(difference / (2 * step))
    return np.stack(columns, axis=-1)


@given(pose, control, dt)
def test_motion_is_the_textbook_arc(x, u, dt):
    nu, omega = u
    if abs(omega) < 1e-3:
        return  # the textbook's own formula cancels there; see the next test
    r = nu / omega
    expected = x + [
        r * (np.sin(x[2] + omega * dt) - np.sin(x[2])),
        r * (np.cos(x[2]) - np.cos(x[2] + omega * dt)),
        omega * dt,
    ]
    np.testing.assert_allclose(motion.f(x, u, dt), expected, atol=1e-11)


@given(st.floats(-1e-5, 1e-5), speed, angle)
def test_motion_near_a_straight_line_has_no_cancellation(omega, nu, theta):
    # Taylor's series of the arc in omega, to the second order: the rest is below 1e-15
    c, s = np.cos(theta), np.sin(theta)
    along, across = nu * (1 - omega**2 / 6), nu * omega / 2
    expected = [along * c - across * s, along * s + across * c, theta + omega]
    np.testing.assert_allclose(motion.f([0, 0, theta], [nu, omega], 1.0), expected, rtol=0, atol=2e-15)


@given(pose, control, dt)
def test_motion_jacobians(x, u, dt):
    np.testing.assert_allclose(motion.F(x, u, dt), numeric(lambda x: motion.f(x, u, dt), x), atol=1e-7)
    np.testing.assert_allclose(motion.A(x, u, dt), numeric(lambda u: motion.f(x, u, dt), u), atol=1e-7)


@given(st.floats(-3, 3))
def test_sinc_derivative_against_its_integral_definition(a):
    # sinc'(a) = -integral over s in [0, 1] of s sin(a s), by Gauss's rule: no division by a anywhere
    nodes, weights = np.polynomial.legendre.leggauss(24)
    s = (nodes + 1) / 2
    assert sinc_derivative(a) == pytest.approx(-np.sum(weights / 2 * s * np.sin(a * s)), abs=1e-15, rel=2e-14)


def test_control_noise_by_hand():
    model = MotionModel(nn=0.1, no=0.2, on=0.3, oo=0.4)
    np.testing.assert_allclose(model.M([-2.0, 0.5], 0.5), np.diag([0.01 * 4 + 0.04 * 1, 0.09 * 4 + 0.16 * 1]))
    covariance = model.covariance(np.zeros(3), [1.0, 0.0], 1.0)
    # driving straight for 1 m: x by nu, heading by omega, y by half the heading error
    np.testing.assert_allclose(covariance, [[0.0101, 0, 0], [0, 0.0226, 0.045], [0, 0.045, 0.0901]], atol=1e-15)


def test_dead_reckoning_is_f_step_by_step():
    rng = np.random.default_rng(1)
    controls, dt = rng.normal(size=(30, 2)), rng.uniform(0.1, 1, 30)
    expected = [np.array([1.0, 2.0, 3.0])]
    for u, step in zip(controls, dt):
        expected.append(motion.f(expected[-1], u, step))
    np.testing.assert_allclose(motion.dead_reckoning(expected[0], controls, dt), expected, atol=1e-12)


@given(pose, sighting)
def test_observation_and_its_inverse(x, z):
    for n in (2, 3):
        landmark = sensor.h_inverse(x, z[:n])
        again = sensor.h(x, landmark)
        assert again[0] == pytest.approx(z[0], rel=1e-9)
        np.testing.assert_allclose(wrap(again[1:] - z[1:n]), 0, atol=1e-9)


@given(pose, sighting)
def test_sensor_jacobians(x, z):
    for n in (2, 3):
        landmark = sensor.h_inverse(x, z[:n])

        def unwrapped(value, z=z, n=n):
            # differences across the seam of the angles would not be derivatives
            return np.concatenate([value[..., :1], z[1:n] + wrap(value[..., 1:] - z[1:n])], axis=-1)

        scale = 1 + 1 / z[0] ** 2
        by_landmark = numeric(lambda m: unwrapped(sensor.h(x, m)), landmark)
        by_pose = numeric(lambda x, m=landmark: unwrapped(sensor.h(x, m)), x)
        np.testing.assert_allclose(sensor.H(x, landmark), by_landmark, atol=1e-6 * scale)
        np.testing.assert_allclose(sensor.H_pose(x, landmark), by_pose, atol=1e-6 * scale)

        def place(z, m=landmark, n=n):
            value = sensor.h_inverse(x, z)
            if n == 3:
                value[2] = m[2] + wrap(value[2] - m[2])
            return value

        np.testing.assert_allclose(sensor.R(x, z[:n]), numeric(place, z[:n]), atol=1e-6)


def test_sensor_noise_by_hand():
    model = SensorModel(range_rate=0.1, bearing_std=0.2, orientation_std=0.3)
    np.testing.assert_allclose(model.Q([2.0, 0.0, 0.0]), np.diag([0.04, 0.04, 0.09]))
    np.testing.assert_allclose(model.Q([2.0, 0.0]), np.diag([0.04, 0.04]))
    # straight ahead along x: range noise in x, bearing noise times the range in y, both angles in the heading
    expected = [[0.04, 0, 0], [0, 0.16, 0.08], [0, 0.08, 0.13]]
    np.testing.assert_allclose(model.landmark_covariance(np.zeros(3), [2.0, 0.0, 0.0]), expected, atol=1e-15)


def test_models_are_vectorised():
    rng = np.random.default_rng(2)
    x, u, z = rng.normal(size=(4, 5, 3)), rng.normal(size=(4, 5, 2)), rng.uniform(0.5, 2, size=(4, 5, 3))
    for result, single in (
        (motion.f(x, u, 0.5), lambda i: motion.f(x[i], u[i], 0.5)),
        (motion.F(x, u, 0.5), lambda i: motion.F(x[i], u[i], 0.5)),
        (motion.A(x, u, 0.5), lambda i: motion.A(x[i], u[i], 0.5)),
        (motion.covariance(x, u, 0.5), lambda i: motion.covariance(x[i], u[i], 0.5)),
        (sensor.h_inverse(x, z), lambda i: sensor.h_inverse(x[i], z[i])),
        (sensor.h(x, z), lambda i: sensor.h(x[i], z[i])),
        (sensor.H(x, z), lambda i: sensor.H(x[i], z[i])),
        (sensor.landmark_covariance(x, z), lambda i: sensor.landmark_covariance(x[i], z[i])),
    ):
        np.testing.assert_allclose(result[2, 3], single((2, 3)), atol=1e-15)


@pytest.mark.parametrize(
    "make",
    [
        lambda: MotionModel(nn=-0.1),
        lambda: MotionModel(epsilon=0.0),
        lambda: MotionModel(oo=float("nan")),
        lambda: SensorModel(range_rate=0.0),
        lambda: SensorModel(bearing_std=-1.0),
        lambda: SensorModel(orientation_std=float("inf")),
    ],
)
def test_impossible_noise_is_refused_with_its_name(make):
    with pytest.raises(OptionError, match="must be a positive number"):
        make()


def propagated(model, controls, dt, extra):
    """The pose and covariance after controls, one by one: P <- F P F' + A M A' + slip² |nu| dt n n'."""
    x, P = np.zeros(3), np.zeros((3, 3))
    for u, step, more in zip(controls, dt, extra):
        F, A = model.F(x, u, step), model.A(x, u, step)
        P = F @ P @ F.T + A @ (model.M(u, step) + np.diag(more)) @ A.T
        start, x = x, model.f(x, u, step)
        chord = np.append(x[:2] - start[:2], 0.0)
        n = np.array([-chord[1], chord[0], 0.0]) / np.hypot(*chord[:2])
        P += model.slip**2 * abs(u[0]) * step * np.outer(n, n)
    return x, P + model.epsilon * np.eye(3)


@given(st.integers(0, 2**32 - 1))
def test_accumulated_motions_are_the_propagation_control_by_control(seed):
    rng = np.random.default_rng(seed)
    model = MotionModel(nn=0.2, no=0.1, on=0.1, oo=0.3, epsilon=1e-6, sigma_v=0.1, sigma_omega=0.2, slip=0.3)
    starts = np.concatenate([[0], np.cumsum(rng.integers(1, 6, size=5))])
    controls, dt = rng.normal(size=(starts[-1], 2)), rng.uniform(0.01, 1, starts[-1])
    extra = rng.uniform(0, 0.1, controls.shape)
    motions, covariances = model.accumulate(controls, dt, starts, extra)
    for t, (a, b) in enumerate(zip(starts[:-1], starts[1:])):
        x, P = propagated(model, controls[a:b], dt[a:b], extra[a:b])
        np.testing.assert_allclose(motions[t], x, atol=1e-12)
        np.testing.assert_allclose(covariances[t], P, atol=1e-12)


def test_a_motion_of_one_control_is_f_and_its_covariance_to_rounding():
    rng = np.random.default_rng(3)
    controls, dt = rng.normal(size=(50, 2)), rng.uniform(0.1, 1, 50)
    origin = np.zeros((50, 3))
    for model in (motion, motion.changed(slip=0.1)):
        motions, covariances = model.accumulate(controls, dt, np.arange(51))
        assert np.array_equal(motions, model.f(origin, controls, dt))
        # the engine adds in the axes of the chord
        np.testing.assert_allclose(covariances, model.covariance(origin, controls, dt), rtol=1e-13, atol=1e-16)


@given(st.integers(0, 2**32 - 1))
def test_the_engine_moves_and_places_as_the_models_do(seed):
    rng = np.random.default_rng(seed)
    model = MotionModel(nn=0.2, no=0.1, on=0.1, oo=0.3, epsilon=1e-6, sigma_v=0.1, sigma_omega=0.2, slip=0.3)
    control, dt = rng.normal(size=2) * [1.0, rng.choice([0.0, 1e-5, 1.0])], rng.uniform(0.01, 2)
    (mean,), (covariance,) = model.accumulate(control[None], [dt], np.array([0, 1]))
    for found, expected in zip(model.moved(control, dt), (mean, covariance)):
        np.testing.assert_allclose(found, expected, atol=1e-15, rtol=1e-13)
    sensor = SensorModel(range_std=0.1, offset=tuple(rng.normal(size=2)))
    sightings, noisy = rng.normal(size=(2, 5, rng.choice([2, 3])))
    by_models = sensor.h_inverse(np.zeros((5, 3)), sightings), sensor.landmark_covariance(np.zeros((5, 3)), noisy)
    for found, expected in zip(sensor.places(sightings, noisy=noisy), by_models):
        np.testing.assert_allclose(found, expected, atol=1e-14, rtol=1e-13)


def test_accumulated_covariance_against_samples():
    model, rng = MotionModel.constant(0.02, 0.05, epsilon=1e-9), np.random.default_rng(0)
    controls, dt = np.array([[1.0, 0.3], [0.5, -0.8], [0.8, 0.1]]), np.array([0.5, 0.4, 0.6])
    (mean,), (P,) = model.accumulate(controls, dt, np.array([0, 3]))
    x = np.zeros((200_000, 3))
    for u, step in zip(controls, dt):
        x = model.f(x, u + rng.normal(size=(len(x), 2)) * [0.02, 0.05], step)
    # 200,000 samples give a covariance to about 1 %
    np.testing.assert_allclose(x.mean(axis=0), mean, atol=1e-3)
    np.testing.assert_allclose(np.cov(x.T), P, atol=0.02 * np.max(P))


def test_constant_noise_is_of_every_control():
    model = MotionModel.constant(0.1, 0.3)
    np.testing.assert_allclose(model.M([[0.0, 0.0], [5.0, 1.0]], [0.01, 7.0]), [np.diag([0.01, 0.09])] * 2)


def test_the_sensor_sits_where_its_offset_says():
    eyes = SensorModel(offset=(2.0, 1.0))
    # looking along y, 2 m ahead is up and 1 m to the left is -x
    np.testing.assert_allclose(eyes.mount([1.0, 1.0, np.pi / 2]), [0.0, 3.0, np.pi / 2], atol=1e-15)
    np.testing.assert_allclose(eyes.h([1.0, 1.0, np.pi / 2], [0.0, 5.0]), [2.0, 0.0], atol=1e-15)
    assert SensorModel(offset=0.5).offset == (0.5, 0.0)


@given(pose, sighting)
def test_jacobians_of_a_sensor_with_an_offset(x, z):
    eyes = SensorModel(offset=(0.4, -0.2))
    for n in (2, 3):
        landmark = eyes.h_inverse(x, z[:n])
        again = eyes.h(x, landmark)
        np.testing.assert_allclose(wrap(again[1:] - z[1:n]), 0, atol=1e-9)

        def unwrapped(value, z=z, n=n):
            return np.concatenate([value[..., :1], z[1:n] + wrap(value[..., 1:] - z[1:n])], axis=-1)

        scale = 1 + 1 / z[0] ** 2
        by_pose = numeric(lambda x, m=landmark: unwrapped(eyes.h(x, m)), x)
        by_landmark = numeric(lambda m: unwrapped(eyes.h(x, m)), landmark)
        np.testing.assert_allclose(eyes.H_pose(x, landmark), by_pose, atol=1e-6 * scale)
        np.testing.assert_allclose(eyes.H(x, landmark), by_landmark, atol=1e-6 * scale)


def test_range_noise_has_a_constant_part():
    Q = SensorModel(range_rate=0.1, range_std=0.3).Q([4.0, 0.0])
    assert Q[0, 0] == pytest.approx(0.16 + 0.09)
    assert SensorModel(range_rate=0.0, range_std=0.3).Q([4.0, 0.0])[0, 0] == pytest.approx(0.09)


@pytest.mark.parametrize("offset", [(1.0, np.nan), (1.0, 2.0, 3.0), np.inf])
def test_an_impossible_offset_is_refused(offset):
    with pytest.raises(OptionError, match="offset must be"):
        SensorModel(offset=offset)


@pytest.mark.parametrize("offset", [(0.3, "x"), "ahead", (1.0, 2.0, 3.0), (np.nan, 0.0)])
def test_an_offset_is_two_numbers(offset):
    with pytest.raises(OptionError, match="offset must be"):
        SensorModel(offset=offset)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        # the two ways to describe the noise of the motion replace each other
        ({"sigma_v": 0.3}, {"nn": 0, "no": 0, "on": 0, "oo": 0, "sigma_v": 0.3, "sigma_omega": 0.2}),
        ({"nn": 0.3}, {"nn": 0.3, "no": 0.001, "oo": 0.2, "sigma_v": 0, "sigma_omega": 0}),
        ({"nn": 0.3, "sigma_v": 0.4}, {"nn": 0.3, "on": 0.13, "sigma_v": 0.4, "sigma_omega": 0.2}),
        ({"epsilon": 1e-6, "nn": None}, {"epsilon": 1e-6, "nn": 0.19, "sigma_v": 0.1}),
    ],
)
def test_options_change_a_motion_model(options, expected):
    changed = MotionModel(sigma_v=0.1, sigma_omega=0.2).changed(**options)
    assert {name: getattr(changed, name) for name in expected} == expected


def test_options_change_a_sensor_model():
    constant = SensorModel().changed(range_std=0.2)
    assert (constant.range_rate, constant.range_std, constant.bearing_std) == (0.0, 0.2, 0.05)
    assert constant.changed(range_rate=0.1).range_std == 0.0
    assert SensorModel().changed(range_rate=0.1, range_std=0.2).Q([2.0, 0.0])[0, 0] == pytest.approx(0.08)
    with pytest.raises(OptionError, match="SensorModel has no 'range'; its fields are range_rate"):
        SensorModel().changed(range=1.0)


def test_the_limits_of_a_sensor_hold_at_the_sensor():
    sensor = SensorModel(offset=(1.0, 0.0), min_range=0.5, max_range=2.0, field_of_view=np.pi / 2)
    pose = [3.0, 1.0, np.pi / 2]  # the sensor is at (3, 2) and looks along y
    seen = {
        (3.0, 3.9): True,
        (3.0, 4.1): False,
        (3.0, 2.4): False,
        (4.0, 3.1): True,
        (4.1, 2.9): False,
        (3.0, 0.5): False,
    }
    np.testing.assert_array_equal(sensor.sees(pose, np.array(list(seen))), list(seen.values()))
    assert SensorModel().sees(pose, [1e6, -1e6])


@pytest.mark.parametrize(
    "limits", [{"max_range": 0.0}, {"min_range": -1.0}, {"min_range": 3.0, "max_range": 2.0}, {"field_of_view": 0.0},
               {"field_of_view": 7.0}, {"max_range": float("nan")}],
)  # fmt: skip
def test_impossible_limits(limits):
    with pytest.raises(OptionError, match="min_range must lie|field_of_view must be"):
        SensorModel(**limits)
