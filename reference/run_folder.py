"""What a run folder says of itself: keys of run.toml and of the columns in signals.parquet; a test reads real runs by them."""

from __future__ import annotations

from robomill.orchestration.runs.recorder import SCHEMA
from robomill.orchestration.system import keys
from robomill.orchestration.system.keys import Keys, default, optional, required

FILES = {
    "run.toml": "What the run is; there from its beginning.",
    "signals.parquet": "One row per recorded step; the first column `t` is the time in s. In its place may stand signals.csv.",
    "signals.arrow": "The same rows while the run is being written, as an Arrow stream; readable at any moment.",
    "signals.csv": "The same rows as text, with `--csv`.",
    "checkpoint.zip": "All that `--resume` goes on from, with `--checkpoint-every`.",
}


class ClockKeys(Keys):
    """The time of the rows."""

    column = required(keys.text(), "`t`")
    unit = required(keys.text(), "`s`")
    step = required(keys.number(), "communication step [s]; of a measured run the median distance of rows")
    every = required(keys.count(1), "each how many steps a row is written")


class ColumnKeys(Keys):
    """One column of the signals."""

    port = required(keys.text(), "`component.port`, elements as `drive.q_link[2]`")
    unit = required(keys.text(blank=True), "unit, SI; empty where it is not known")
    frame = required(keys.text(blank=True), "frame that the port is expressed in, a capital letter of its name; may be empty")
    type = required(keys.choice(("real", "integer", "boolean")), "type of the port")


class RunKeys(Keys):
    """run.toml. Only `columns` and `clock` are needed to read a run; programs write the rest, and values without unit are SI."""

    schema = required(keys.text(), f"`{SCHEMA}`")
    outcome = required(keys.choice(("running", "finished", "interrupted", "failed")), "how the run ended")
    message = required(keys.text(blank=True), "why it ended early")
    created = required(keys.text(), "date and time at which it began (ISO 8601, UTC)")
    resumed = optional(keys.anything("list of numbers"), "times at which it was resumed [s]")
    kind = required(keys.choice(("simulated", "measured")), "where it comes from")
    program = required(keys.text(blank=True), "the program that ran")
    robot = required(keys.text(blank=True), "the robot")
    tool = required(keys.text(blank=True), "the tool")
    workpiece = required(keys.text(blank=True), "the workpiece")
    system = optional(keys.text(), "name of the system (simulated)")
    description = optional(keys.text(blank=True), "what the system is, or what was recorded")
    source = optional(keys.text(), "where the log comes from (measured)")
    licence = optional(keys.text(), "licence of the data (measured)")
    imported = optional(keys.anything("table"), "file, mapping and time of the log that the run was imported from (measured)")
    algorithm = optional(keys.text(), "how the components were stepped (simulated)")
    warnings = optional(keys.texts(), "what was to be said of the system (simulated)")
    rates = default({}, keys.named(keys.number(), "component"), "steps of a component in each step of the system, where not 1")
    sources = default({}, keys.named(keys.text(), "component"), "what stood there (simulated)")
    connections = optional(keys.texts(), "what was connected to what (simulated)")
    files = optional(keys.named(keys.text(), "file"), "hash of each file that a parameter names (simulated)")
    parameters = default(
        {}, keys.anything("table of `component.parameter = value`"), "all parameters, or those that the experimenter knows"
    )
    inputs = default({}, keys.anything("table of `component.input = value`"), "start values of inputs (simulated)")
    labels = default(
        {}, keys.anything("table of `name = value`"), "condition, repeat, held_out, tier, kind, samples and whatever else was given"
    )
    clock = required(keys.table(ClockKeys), "the time of the rows")
    columns = required(keys.tables(ColumnKeys, '"component.port"'), "the columns, in order")
