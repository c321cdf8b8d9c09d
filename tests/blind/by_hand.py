"""Truths and predictions written by hand, whose scores can be counted."""

from __future__ import annotations

from robomill.blind.case import Case, Cases
from robomill.blind.prediction import Named, Prediction
from robomill.blind.truth import Truth

PARTS = {"outside": {"component": None, "value": 1.0, "unit": "1"}, "bad_log": {"channel": "sensor.f_T_T", "value": 1.0, "unit": "1"}}


def truth(kind, *effects, detectability=20.0, **more):
    """The content of a sealed file."""
    listed = [
        {"component": c, "effect": p.partition("[")[0], "parameter": p, "index": Named.of(c, p).index, "value": v, "unit": "1"}
        for c, p, v in effects
    ]
    more |= {part: PARTS[part] | more[part] for part in PARTS if part in more}
    return {"kind": kind, "effects": listed, "detectability": detectability, **more}


def entry(component, parameter, probability, value=1.0, interval=(0.0, 2.0), confusable=()):
    parameters = {parameter: {"value": value, "interval": list(interval), "unit": "1"}}
    name = parameter.partition("[")[0]
    return {"effect": name, "component": component, "probability": probability, "parameters": parameters, "confusable_with": confusable}


def said(verdict, *which, **more):
    return Prediction.read({"verdict": verdict, "which": list(which), **more})


def benchmark(tier="T1", seed=1, truth="", files=None, name="mixed"):
    """The content of benchmark.json."""
    head = {"schema": "robomill-blind/2", "version": 3, "cases": 1, "seed": seed, "tier": tier, "set": name, "generator": "first"}
    return {**head, "truth": truth, "files": files or {}}


def cases(*pairs, **more):
    return Cases([Case(i, Truth.read(t), p) for i, (t, p) in enumerate(pairs, 1)], **more)


STIFF = ("compliance", "stiffness_error[2]", 0.2)
GAIN = ("sensor", "sensor_gain_error", 0.1)
