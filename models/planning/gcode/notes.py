"""Notes of a reading: what was skipped, counted and said once; what was decided in the program's place."""

from __future__ import annotations


class Notes:
    """Collects while a program is read; `texts` at the end."""

    def __init__(self) -> None:
        self._skipped: dict[tuple[str, str], int] = {}
        self._said: dict[str, None] = {}
        self.slack = 0.0
        """Largest difference [m] of the radii at start and end of an arc."""

    def skip(self, what: str, why: str) -> None:
        """Count a word that has no effect here, such as ``M8`` (``coolant``)."""
        key = (what, why)
        self._skipped[key] = self._skipped.get(key, 0) + 1

    def say(self, text: str) -> None:
        """Keep a text; the same one only once."""
        self._said[text] = None

    @property
    def texts(self) -> tuple[str, ...]:
        """The notes: one line for all that was skipped, grouped by reason, then one per decision."""
        by_reason: dict[str, list[str]] = {}
        for (what, why), count in self._skipped.items():
            by_reason.setdefault(why, []).append(what if count == 1 else f"{what} x {count}")
        lines = list(self._said)
        if by_reason:
            lines.insert(0, "skipped: " + "; ".join(f"{', '.join(words)} ({why})" for why, words in by_reason.items()))
        if self.slack > 1e-6:
            lines.append(
                f"arcs whose radii at start and end differ by up to {1e3 * self.slack:.4f} mm (rounding): centre moved so that both fit"
            )
        return tuple(lines)
