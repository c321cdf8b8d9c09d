"""The physics of robomill: pure functions on immutable parameters and one explicit state record.

No FMI and no run files here. A model is a table of declared variables and two plain
functions, `init(s)` and `step(s, t, h)`; see `models.model.declaration`.
"""
