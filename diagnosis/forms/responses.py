"""What a push at an input does, at any time of a run: seen after a few pulses, and drawn between them.

A law at an input may be one of thousands, and to simulate each of them takes minutes. What small pushes do adds up. So the response to a
short pulse is simulated at the start of each of FOLDS parts of a run. The response to a pulse between two of them is drawn between theirs.
A law is a series of pulses, one in each block.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from robomill.diagnosis.experiment.simulation import decimate
from robomill.diagnosis.forms.selection import Labels
from robomill.diagnosis.inference.ceiling import FOLDS
from robomill.orchestration.slaves.protocol import FloatArray


@dataclass(frozen=True)
class Response:
    """Responses of a run of n blocks to an input."""

    at: Labels
    """Blocks of the pulses, [pulses]."""
    after: FloatArray
    """What one unit of the input in one block does from then on, block means, [pulses, n, channels]."""

    @staticmethod
    def of(does: Callable[[FloatArray], FloatArray], samples: int, factor: int, width: int, push: float) -> Response:
        """Simulate the pulses.

        `does`: what all channels do, [samples, channels], where a series [samples] is added to the input. `factor`: samples of a block;
        `width`: blocks that a pulse lasts, so that a slow component sees it; `push`: its size [unit of the input].
        """
        n = samples // factor
        at = np.unique(np.arange(FOLDS) * n // FOLDS)
        responses: list[FloatArray] = []
        for start in at:
            pulse = np.zeros(samples)
            pulse[start * factor : (start + width) * factor] = push
            seen = decimate(does(pulse), factor)[start:] / (push * min(width, n - start))
            rest = responses[-1][len(seen) :] if responses else seen[:0]  # a later pulse is not seen for so long: as the one before it
            responses.append(np.concatenate([seen, rest]))
        return Response(at, np.stack(responses))

    def to(self, x: FloatArray) -> FloatArray:
        """What series of the input do, block means [n, series] -> [n, channels, series]."""
        n = len(x)
        long = next_fast_len(2 * n, real=True)
        block = np.arange(n)
        shares = [np.interp(block, self.at, one) for one in np.eye(len(self.at))]
        given = [rfft(share[:, None] * x, long, axis=0) for share in shares]
        found = np.empty((n, self.after.shape[2], x.shape[1]))
        for c in range(self.after.shape[2]):
            passed = rfft(self.after[:, :, c], long, axis=1)
            found[:, c] = irfft(sum(p[:, None] * g for p, g in zip(passed, given, strict=True)), long, axis=0)[:n]
        return found
