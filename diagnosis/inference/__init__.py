"""Which effects explain the gap: noise, evidence, sensitivities, estimation, search."""
