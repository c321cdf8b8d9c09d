"""Component kalman_sensor: a force-torque sensor whose signal is smoothed by a Kalman filter instead of a low-pass.

It stands in for `sensor_chain`: the ports that the milling cell connects are the same. The weight of the tool is taken off exactly.
"""

from kalman_sensor.kalman import gains, update
from robomill.models.maths.elementary import exp
from robomill.models.maths.frames import mat_t_vec
from robomill.models.maths.noise import normal_pair
from robomill.models.model.declaration import Model, Record, Variable, kernel
from robomill.models.robot.kinematics import KR300, SPINDLE_ACROSS, robot_variables, tool_pose


@kernel
def _load(s: Record) -> None:
    """Set s.f_T_raw and s.m_T_raw to the load on the tool, in T."""
    tool_pose(s, s.q, s.p_BT, s.R_BT)
    mat_t_vec(s.R_BT, s.f_T_B, s.f_T_raw)
    mat_t_vec(s.R_BT, s.m_T_B, s.m_T_raw)


@kernel
def _add_creep(s: Record, share: float) -> None:
    """The strain gauges go on giving way: a part `creep` of the load follows it with the time constant creep_time."""
    for i in range(3):
        s.crept[i] += share * (s.f_T_raw[i] - s.crept[i])
        s.crept[3 + i] += share * (s.m_T_raw[i] - s.crept[3 + i])
        s.f_T_raw[i] += s.creep * s.crept[i]
        s.m_T_raw[i] += s.creep * s.crept[3 + i]


@kernel
def _add_noise(s: Record) -> None:
    for i in range(3):
        force, moment = normal_pair(int(s.seed), int(s.counter), i)
        s.f_T_raw[i] += s.noise_f * force
        s.m_T_raw[i] += s.noise_m * moment


@kernel
def _show(s: Record) -> None:
    for i in range(3):
        s.f_T_T[i] = s.estimate[i, 0]
        s.m_T_T[i] = s.estimate[3 + i, 0]


def init(s: Record) -> int:
    """The load comes on at t = 0: the filter shows it, nothing has crept."""
    s.counter = 0
    _load(s)
    for i in range(3):
        s.crept[i] = 0.0
        s.crept[3 + i] = 0.0
        s.estimate[i, 0] = s.f_T_raw[i]
        s.estimate[3 + i, 0] = s.m_T_raw[i]
        s.estimate[i, 1] = 0.0
        s.estimate[3 + i, 1] = 0.0
        s.covariance_f[i] = 0.0
        s.covariance_m[i] = 0.0
    _show(s)
    return 0


def step(s: Record, t: float, h: float) -> int:
    """One measurement at t + h."""
    s.counter += 1
    _load(s)
    _add_creep(s, 1.0 - exp(-h / s.creep_time))
    _add_noise(s)
    gains(s.covariance_f, h, s.wander_f, s.noise_f, s.gain_f)
    gains(s.covariance_m, h, s.wander_m, s.noise_m, s.gain_m)
    for i in range(3):
        update(s.estimate[i], s.f_T_raw[i], h, s.gain_f)
        update(s.estimate[3 + i], s.m_T_raw[i], h, s.gain_m)
    _show(s)
    return 0


MODEL = Model(
    "kalman_sensor",
    "Force-torque sensor with a Kalman filter for a load whose rate of change wanders",
    (
        Variable("f_T_B", "input", "Cutting force on the tool at T, in B", "N", (3,)),
        Variable("m_T_B", "input", "Cutting moment on the tool about T, in B", "N.m", (3,)),
        Variable("q", "input", "Axis angles A1..A6 of the motors", "rad", (6,), KR300.q_home, display_unit="deg"),
        Variable("f_T_raw", "output", "Force as it is measured, in T", "N", (3,)),
        Variable("m_T_raw", "output", "Moment about T as it is measured, in T", "N.m", (3,)),
        Variable("f_T_T", "output", "Estimated force on the tool at T, in T", "N", (3,)),
        Variable("m_T_T", "output", "Estimated moment on the tool at T, in T", "N.m", (3,)),
        Variable("noise_f", "parameter", "Standard deviation of the noise of each force sample; the filter knows it", "N", (), 1.0, 1e-6),
        Variable(
            "noise_m", "parameter", "Standard deviation of the noise of each moment sample; the filter knows it", "N.m", (), 0.1, 1e-6
        ),
        Variable("seed", "parameter", "Seed of the noise: another seed is another repeat of a run", "1", (), 1, 0, 2147483647, "integer"),
        Variable("wander_f", "parameter", "By how much the rate of the force changes in a step, standard deviation", "N/s", (), 150.0, 0.0),
        Variable(
            "wander_m", "parameter", "By how much the rate of the moment changes in a step, standard deviation", "N.m/s", (), 15.0, 0.0
        ),
        # an effect is zero unless something is wrong with the machine; catalogue.toml says how large it may be
        Variable("creep", "parameter", "Part of the load by which the reading creeps after it", "1", (), 0.0, 0.0, 0.5, effect=True),
        Variable("creep_time", "parameter", "Time constant of the creep", "s", (), 0.5, 1e-3),
        *robot_variables(KR300, SPINDLE_ACROSS),
        Variable("counter", "state", "Samples since the start", "1", kind="integer"),
        Variable("p_BT", "state", "Tool tip in B", "m", (3,)),
        Variable("R_BT", "state", "Orientation of T in B", "1", (3, 3)),
        Variable("crept", "state", "What the creep follows, Fx Fy Fz (N) Mx My Mz (N m)", "1", (6,)),
        Variable("estimate", "state", "Filtered value and rate of Fx Fy Fz Mx My Mz", "1", (6, 2)),
        Variable("covariance_f", "state", "Covariance of a force and its rate: xx, xv, vv", "1", (3,)),
        Variable("covariance_m", "state", "Covariance of a moment and its rate: xx, xv, vv", "1", (3,)),
        Variable("gain_f", "state", "Gain of the filter of the forces", "1", (2,)),
        Variable("gain_m", "state", "Gain of the filter of the moments", "1", (2,)),
    ),
    init,
    step,
)
