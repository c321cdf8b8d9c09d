"""Fuzzy inference: triangular memberships that add up to one, rules with singletons, weighted mean (Sugeno, order zero)."""

from __future__ import annotations

from robomill.models.model.declaration import FloatArray, kernel


@kernel
def memberships(x: float, centres: FloatArray, grades: FloatArray) -> None:
    """Set grades (n,): how far x belongs to the triangles with these rising centres (n,), each ending where its neighbours peak.

    Beyond the outer centres the outer set has the grade one.
    """
    n = centres.shape[0]
    for i in range(n):
        grades[i] = 0.0
    if x <= centres[0]:
        grades[0] = 1.0
        return
    for i in range(n - 1):
        if x <= centres[i + 1]:
            grades[i + 1] = (x - centres[i]) / (centres[i + 1] - centres[i])
            grades[i] = 1.0 - grades[i + 1]
            return
    grades[n - 1] = 1.0


@kernel
def conclusion(rules: FloatArray, rows: FloatArray, columns: FloatArray) -> float:
    """Sum of rules[i, j] rows[i] columns[j]: each rule (m, n) weighted by how far both premises hold.

    The weights add up to one, so that nothing is left to divide by.
    """
    total = 0.0
    for i in range(rules.shape[0]):
        for j in range(rules.shape[1]):
            total += rows[i] * columns[j] * rules[i, j]
    return total
