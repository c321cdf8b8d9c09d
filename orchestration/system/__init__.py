"""A system as data: system files, written values, connections, feedthrough and algebraic loops."""
