"""A Kalman filter for a quantity that changes at a rate that wanders: state (x, v), measured is x with white noise.

x(k+1) = x(k) + h v(k), v(k+1) = v(k) + w(k); z = x + n; w and n white, with standard deviations `wander` and `noise`.
"""

from robomill.models.model.declaration import FloatArray, kernel


@kernel
def gains(covariance: FloatArray, h: float, wander: float, noise: float, gain: FloatArray) -> None:
    """One step of the covariance [3] (xx, xv, vv) after a measurement to the one after the next; sets the gain [2] of that."""
    xx = covariance[0] + 2.0 * h * covariance[1] + h * h * covariance[2]
    xv = covariance[1] + h * covariance[2]
    vv = covariance[2] + wander * wander
    gain[0] = xx / (xx + noise * noise)
    gain[1] = xv / (xx + noise * noise)
    covariance[0] = (1.0 - gain[0]) * xx
    covariance[1] = (1.0 - gain[0]) * xv
    covariance[2] = vv - gain[1] * xv


@kernel
def update(state: FloatArray, z: float, h: float, gain: FloatArray) -> None:
    """The state [2] one step of h [s] on, with what is measured there."""
    x = state[0] + h * state[1]
    innovation = z - x
    state[0] = x + gain[0] * innovation
    state[1] += gain[1] * innovation
