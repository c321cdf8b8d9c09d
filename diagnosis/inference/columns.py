"""Sensitivities of nuisances, B [n, m]: most of them are of one condition only, so that each condition has a matrix of its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from robomill.orchestration.slaves.protocol import FloatArray


@dataclass(frozen=True)
class Piece:
    """Rows of one condition, of the k columns that say anything there."""

    numbers: npt.NDArray[np.intp]
    """Which columns of B they are, [k]."""
    parts: tuple[FloatArray, ...]
    """Matrices that lie side by side, [rows, k] together: what comes later is put beside what is there without a copy of that."""
    products: FloatArray
    """Products of these columns, [k, k]."""

    @staticmethod
    def of(numbers: npt.NDArray[np.intp], values: FloatArray) -> Piece:
        """The columns of `values` [rows, k]."""
        return Piece(numbers, (values,), values.T @ values)

    def across(self, x: FloatArray, first: int, into: FloatArray) -> None:
        """Add to `into` [m, ...] the products of its columns, from number `first` on, with x [rows, ...]."""
        at = 0
        for part in self.parts:
            here = self.numbers[at : at + part.shape[1]]
            at += part.shape[1]
            if here.size and here[-1] >= first:
                into[here] += part.T @ x

    def along(self, v: FloatArray) -> FloatArray:
        """The sum of its columns, each times its element of v [m]: [rows]."""
        edges = np.cumsum([part.shape[1] for part in self.parts])[:-1]
        return np.asarray(sum(part @ v[here] for part, here in zip(self.parts, np.split(self.numbers, edges), strict=True)))

    def beside(self, numbers: npt.NDArray[np.intp], values: FloatArray) -> Piece:
        """With more columns after these, `values` [rows, l]."""
        mixed = np.concatenate([part.T @ values for part in self.parts])
        products = np.block([[self.products, mixed], [mixed.T, values.T @ values]])
        return Piece(np.append(self.numbers, numbers), (*self.parts, values), products)

    def toarray(self) -> FloatArray:
        """Its columns, [rows, k]."""
        return np.concatenate(self.parts, axis=1)


class Columns:
    """B [n, m], by condition."""

    def __init__(self, pieces: Sequence[tuple[slice, Piece]], n: int, m: int) -> None:
        """`pieces`: which rows, and what of them is not zero; no row is in two of them."""
        self.pieces, self.shape = tuple(pieces), (n, m)

    @staticmethod
    def of(matrix: FloatArray, blocks: Mapping[str, slice]) -> Columns:
        """The columns of a matrix [n, m]; `blocks`: condition -> its rows (empty: all are of one)."""
        n, m = matrix.shape
        return Columns([(rows, Piece.of(*_nonzero(matrix[rows], 0))) for rows in blocks.values() or [slice(0, n)]], n, m)

    @staticmethod
    def joined(parts: Sequence[tuple[str | None, FloatArray]], blocks: Mapping[str, slice]) -> Columns:
        """Columns one after the other: of all conditions (None), [n, k], or of the condition of that name, [its rows, k]."""
        found, n = [], max(rows.stop for rows in blocks.values())
        for name, rows in blocks.items():
            here, first = [], 0
            for condition, values in parts:
                if condition is None or condition == name:
                    here.append(_nonzero(values[rows] if condition is None else values, first))
                first += values.shape[1]
            numbers, columns = zip(*here, strict=True)
            found.append((rows, Piece.of(np.concatenate(numbers), np.concatenate(columns, axis=1))))
        return Columns(found, n, sum(values.shape[1] for _, values in parts))

    def across(self, x: FloatArray, first: int = 0) -> FloatArray:
        """B'x of a vector [n] or matrix [n, k]: [m] or [m, k]; of the columns from number `first` on, zero for those before."""
        made = np.zeros((self.shape[1], *x.shape[1:]))
        for rows, piece in self.pieces:
            piece.across(x[rows], first, made)
        return made

    def along(self, v: FloatArray) -> FloatArray:
        """B v of a vector [m]: [n]."""
        made = np.zeros(self.shape[0])
        for rows, piece in self.pieces:
            made[rows] = piece.along(v)
        return made

    def products(self) -> FloatArray:
        """B'B, [m, m]."""
        made = np.zeros((self.shape[1], self.shape[1]))
        for _, piece in self.pieces:
            made[np.ix_(piece.numbers, piece.numbers)] += piece.products
        return made

    def beside(self, matrix: FloatArray) -> Columns:
        """With these columns [n, k] after the others."""
        n, m = self.shape
        return Columns([(rows, piece.beside(*_nonzero(matrix[rows], m))) for rows, piece in self.pieces], n, m + matrix.shape[1])

    def chosen(self, kept: Sequence[int]) -> Columns:
        """These columns alone."""
        place = np.full(self.shape[1], -1)
        place[list(kept)] = np.arange(len(kept))
        found = []
        for rows, piece in self.pieces:
            here = np.flatnonzero(place[piece.numbers] >= 0)
            found.append((rows, Piece(place[piece.numbers[here]], (piece.toarray()[:, here],), piece.products[np.ix_(here, here)])))
        return Columns(found, self.shape[0], len(kept))

    def restricted(self, blocks: Sequence[slice]) -> Columns:
        """The rows of these conditions alone, one after the other."""
        pieces = {(rows.start, rows.stop): piece for rows, piece in self.pieces}
        found, n = [], 0
        for rows in blocks:
            found.append((slice(n, n + rows.stop - rows.start), pieces[rows.start, rows.stop]))
            n = found[-1][0].stop
        return Columns(found, n, self.shape[1])

    def toarray(self) -> FloatArray:
        """B [n, m], with all that is zero."""
        made = np.zeros(self.shape)
        for rows, piece in self.pieces:
            made[rows, piece.numbers] = piece.toarray()
        return made


def _nonzero(values: FloatArray, first: int) -> tuple[npt.NDArray[np.intp], FloatArray]:
    """Those columns of a matrix [rows, k] that are not zero, and their numbers: those of the matrix are `first` and on."""
    here = np.flatnonzero(np.any(values, axis=0))
    return first + here, values[:, here]
