"""A rod that is heated at one end, in four components: recipe, controller, rod (with its heater block) and thermocouples.

    C_b dT_b/dt = P - (T_b - T_1) / (R + R_c) - G_b (T_b - T_a)                                  block, with the power P
    C dT_i/dt   = K (T_(i-1) - 2 T_i + T_(i+1)) - G (T_i - T_a), at the ends with one neighbour  rod, i = 1 .. 10
    tau dT_s/dt = T - T_s                                                                        thermocouple

The controller is a PI with a limited power; it sees the thermocouple in the middle of the rod.
"""

from robomill.models.maths.elementary import exp
from robomill.models.model.declaration import Model, Record, Variable, kernel

LEVELS, NODES, SENSORS = 4, 10, 3
LONGEST = 0.5
"""Time [s] of a step of the integration at most; a node of the rod settles with its neighbours in 10 s."""
ROOM = 293.15


@kernel
def _plan(s: Record, t: float) -> None:
    """The set temperature at t: ramps from level to level, each held for as long as the recipe says."""
    begin, s.set = 0.0, s.start
    for i in range(LEVELS):
        way = s.level[i] - s.set
        ramp = abs(way) / s.rate
        s.set += way * min(max((t - begin) / ramp, 0.0), 1.0) if ramp > 0.0 else 0.0
        begin += ramp + s.hold
        if t < begin:
            return


def recipe_init(s: Record) -> int:
    """The recipe at t = 0."""
    _plan(s, 0.0)
    return 0


def recipe_step(s: Record, t: float, h: float) -> int:
    """The recipe at t + h."""
    _plan(s, t + h)
    return 0


RECIPE = Model(
    "rod_recipe",
    "Set temperature: four levels with ramps between them",
    (
        Variable("set", "output", "Set temperature", "K", start=ROOM, display_unit="degC", depends_on=()),
        Variable("start", "parameter", "Set temperature at the start", "K", (), ROOM, 0.0, display_unit="degC"),
        Variable("level", "parameter", "Levels", "K", (LEVELS,), (333.15, 353.15, 338.15, 313.15), 0.0, display_unit="degC"),
        Variable("hold", "parameter", "Time at each level", "s", (), 900.0, 0.0, display_unit="min"),
        Variable("rate", "parameter", "Rate of the ramps", "K/s", (), 0.1, 1e-6),
    ),
    recipe_init,
    recipe_step,
)


def controller_init(s: Record) -> int:
    """No power."""
    s.integral = 0.0
    s.power = 0.0
    return 0


def controller_step(s: Record, t: float, h: float) -> int:
    """The power for the next step, from what is measured at its beginning."""
    error = s.set - s.shown
    wanted = s.gain * (1.0 + s.gain_error) * error + s.integral
    s.power = min(max(wanted, 0.0), s.power_max)
    if s.power == wanted:  # at a limit the integral stands still
        s.integral += s.gain * (1.0 + s.gain_error) * error * h / s.reset_time
    return 0


CONTROLLER = Model(
    "rod_controller",
    "PI controller of a temperature, with a limited power",
    (
        Variable("set", "input", "Set temperature", "K", start=ROOM),
        Variable("shown", "input", "Temperature that is controlled", "K", start=ROOM),
        Variable("power", "output", "Power of the heater that is asked for", "W"),
        Variable("gain", "parameter", "Gain", "W/K", (), 1.0, 0.0),
        Variable("reset_time", "parameter", "Reset time", "s", (), 600.0, 1.0),
        Variable("power_max", "parameter", "Largest power", "W", (), 60.0, 0.0),
        Variable("gain_error", "parameter", "Effect: relative error of the gain", "1", (), 0.0, -0.9, 5.0, effect=True),
        Variable("integral", "state", "Integral part", "W"),
    ),
    controller_init,
    controller_step,
)


@kernel
def _put_out(s: Record) -> None:
    s.temperature[0] = s.block
    s.temperature[1] = 0.5 * (s.node[NODES // 2 - 1] + s.node[NODES // 2])
    s.temperature[2] = s.node[NODES - 1]


def rod_init(s: Record) -> int:
    """All as warm as the room."""
    s.block = s.ambient
    for i in range(NODES):
        s.node[i] = s.ambient
    _put_out(s)
    return 0


def rod_step(s: Record, t: float, h: float) -> int:
    """From t to t + h, with the power held."""
    parts = int(h / LONGEST) + 1
    d = h / parts
    capacity = s.rod_capacity * (1.0 + s.capacity_error) / NODES
    loss = s.rod_loss * (1.0 + s.loss_error) / NODES
    between = s.conductance * (1.0 + s.conductance_error)
    contact = 1.0 / (s.contact_resistance + s.extra_resistance)
    for _ in range(parts):
        s.flow[0] = contact * (s.block - s.node[0])
        for i in range(1, NODES):
            s.flow[i] = between * (s.node[i - 1] - s.node[i])
        s.flow[NODES] = 0.0
        power = s.power * (1.0 + s.power_error)
        s.block += d / s.block_capacity * (power - s.flow[0] - s.block_loss * (s.block - s.ambient))
        for i in range(NODES):
            s.node[i] += d / capacity * (s.flow[i] - s.flow[i + 1] - loss * (s.node[i] - s.ambient))
    _put_out(s)
    return 0


def _effect(name: str, description: str, unit: str = "1", lowest: float = -0.9, highest: float = 10.0, size: int = 0) -> Variable:
    shape = (size,) if size else ()
    return Variable(name, "parameter", f"Effect: {description}", unit, shape, [0.0] * size if size else 0.0, lowest, highest, effect=True)


ROD = Model(
    "rod_thermal",
    "Heater block and rod, losing heat to the room",
    (
        Variable("power", "input", "Power of the heater that is asked for", "W"),
        Variable(
            "temperature",
            "output",
            "Temperature of the block, in the middle and at the end of the rod",
            "K",
            (SENSORS,),
            [ROOM] * SENSORS,
            display_unit="degC",
            depends_on=(),
        ),
        Variable("ambient", "parameter", "Temperature of the room", "K", (), ROOM, 0.0, display_unit="degC"),
        Variable("block_capacity", "parameter", "Heat capacity of the block", "J/K", (), 100.0, 1e-3),
        Variable("block_loss", "parameter", "Heat that the block loses", "W/K", (), 0.05, 0.0),
        Variable("rod_capacity", "parameter", "Heat capacity of the rod", "J/K", (), 305.0, 1e-3),
        Variable("rod_loss", "parameter", "Heat that the rod loses", "W/K", (), 0.25, 0.0),
        Variable("conductance", "parameter", "Heat conductance between two of the ten parts of the rod", "W/K", (), 1.57, 1e-6),
        Variable("contact_resistance", "parameter", "Thermal resistance between block and rod", "K/W", (), 0.4, 1e-6),
        _effect("power_error", "relative error of the power: an aged heater"),
        _effect("loss_error", "relative error of the loss of the rod: insulation, draught"),
        _effect("capacity_error", "relative error of the heat capacity of the rod"),
        _effect("conductance_error", "relative error of the conductance of the rod: another alloy"),
        _effect("extra_resistance", "resistance between block and rod beyond the nominal one: a loose clamp", "K/W", 0.0, 100.0),
        Variable("block", "state", "Temperature of the block", "K"),
        Variable("node", "state", "Temperature of the parts of the rod", "K", (NODES,)),
        Variable("flow", "state", "Scratch: heat flow into each part", "W", (NODES + 1,)),
    ),
    rod_init,
    rod_step,
)


@kernel
def _show(s: Record, t: float) -> None:
    for i in range(SENSORS):
        s.shown[i] = s.sensed[i] + s.gain_error[i] * (s.sensed[i] - s.ice) + s.offset[i] + s.drift[i] * t


def thermocouple_init(s: Record) -> int:
    """Settled."""
    for i in range(SENSORS):
        s.sensed[i] = s.temperature[i]
        s.before[i] = s.temperature[i]
    _show(s, 0.0)
    return 0


def thermocouple_step(s: Record, t: float, h: float) -> int:
    """What is shown at t + h."""
    for i in range(SENSORS):
        # exactly, for a temperature that goes straight from what it was to what it is
        constant, rate = s.time_constant + s.slower[i], (s.temperature[i] - s.before[i]) / h
        settled = s.temperature[i] - rate * constant
        s.sensed[i] = settled + exp(-h / constant) * (s.sensed[i] - s.before[i] + rate * constant)
        s.before[i] = s.temperature[i]
    _show(s, t + h)
    return 0


THERMOCOUPLES = Model(
    "rod_thermocouples",
    "Three thermocouples: block, middle, end",
    (
        Variable("temperature", "input", "Temperatures", "K", (SENSORS,), [ROOM] * SENSORS),
        Variable("shown", "output", "Temperatures as they are shown", "K", (SENSORS,), [ROOM] * SENSORS, display_unit="degC"),
        Variable("time_constant", "parameter", "Time constant of a thermocouple", "s", (), 8.0, 1e-3),
        Variable("ice", "parameter", "Temperature at which a gain does nothing", "K", (), 273.15, 0.0, display_unit="degC"),
        _effect("slower", "time constant beyond the nominal one: a thermocouple that has come loose", "s", 0.0, 1000.0, SENSORS),
        _effect("gain_error", "relative error of the gain", size=SENSORS),
        _effect("offset", "offset", "K", -50.0, 50.0, SENSORS),
        _effect("drift", "drift", "K/s", -1.0, 1.0, SENSORS),
        Variable("sensed", "state", "Temperature of the thermocouples themselves", "K", (SENSORS,)),
        Variable("before", "state", "Temperatures at the beginning of the step", "K", (SENSORS,)),
    ),
    thermocouple_init,
    thermocouple_step,
)
