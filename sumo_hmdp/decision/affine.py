"""Vectors that are affine in the data of a decision: what the coefficients of a compiled model are."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from sumo_hmdp.prediction.branches import IntArray
from sumo_hmdp.prediction.dynamics import FloatArray


@dataclass(frozen=True)
class Affine:
    """A vector that is affine in the data: constant + matrix @ data."""

    constant: FloatArray
    matrix: sparse.csr_array

    def at(self, data: FloatArray) -> FloatArray:
        """Evaluate for the data of one decision."""
        element, datum, factor = self._terms
        # What matrix @ data does, in the same order, without its preparations: they take longer than the product.
        return self.constant + np.bincount(element, factor * data[datum], len(self.constant))

    @cached_property
    def _terms(self) -> tuple[IntArray, IntArray, FloatArray]:
        """The element, datum and factor of each entry, by element."""
        element = np.repeat(np.arange(len(self.constant)), np.diff(self.matrix.indptr))
        return element, self.matrix.indices.astype(np.int64), self.matrix.data


class AffineBuilder:
    """Collects entries of an affine vector."""

    def __init__(self) -> None:
        self.constant: list[float] = []
        self.entries: list[tuple[int, int, float]] = []

    def add(self, constant: float = 0.0) -> int:
        """Add an element with a constant part and return its position."""
        self.constant.append(constant)
        return len(self.constant) - 1

    def depend(self, position: int, slot: int, factor: float) -> None:
        """Let an element grow with a datum by a factor."""
        self.entries.append((position, slot, factor))

    def build(self, slot_count: int) -> Affine:
        """Return the vector, affine in so many data."""
        positions, slots, factors = zip(*self.entries, strict=True) if self.entries else ((), (), ())
        shape = (len(self.constant), slot_count)
        return Affine(np.array(self.constant), sparse.csr_array((factors, (positions, slots)), shape=shape))
