"""What a case says of its calibration is what machines are drawn with."""

from __future__ import annotations

import tomllib

from robomill.blind import world
from robomill.blind.make import CALIBRATION
from robomill.blind.second import machine


def test_the_calibration_of_a_case_is_that_of_the_machines() -> None:
    stated = {}
    for entry in tomllib.loads(CALIBRATION.read_text(encoding="utf-8"))["nuisance"]:
        stated |= {(entry["component"], p): entry.get("relative", entry.get("absolute")) for p in entry["parameters"]}
    drawn = {(c, p): s for table in (world._RELATIVE, world._ABSOLUTE) for c, sigmas in table.items() for p, s in sigmas.items()}
    assert {key: stated[key] for key in drawn} == drawn
    second = {**machine.RELATIVE, **machine.ABSOLUTE}
    names = {
        "omega": "loop_frequency",
        "damping": "loop_damping",
        "mass": "body_mass",
        "rotor": "rotor_inertia",
        "gas": "counterbalance_gas",
    }
    names |= {"chip": "Ktc", "edge": "Kte", "cutoff": "filter_cutoff", "p_FT": "p_FT_F", "payload": "payload_mass", "load": "load_mass"}
    names |= {"cog": "load_cog_S"}
    by_name = {p: s for (_, p), s in drawn.items()}
    assert {n: by_name[names.get(n, n)] for n in second} == second
