"""A network with one hidden layer, y = V tanh(W x + b) + d, in standardised inputs and outputs; Bai 2012 fig. 3."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from haptorb.errors import InputError
from haptorb.numerics.arrays import Array, check_finite

__all__ = ["Perceptron", "Scaling"]


@dataclass(frozen=True, slots=True)
class Scaling:
    """What makes numbers of one kind comparable: (value − mean) / spread, column by column.

    mean     (n,)
    spread   (n,) standard deviations

    Mean and spread are in the values' own unit; scaled values are standardised.
    """

    mean: Array
    spread: Array

    @classmethod
    def of(cls, values: Array, what: str) -> Scaling:
        """That of `values` (samples, n); InputError naming `what` where a column never changes."""
        spread = values.std(axis=0)
        still = np.flatnonzero(~(spread > 1e-12 * np.abs(values).max()))
        if still.size:
            raise InputError(
                f"{what} {', '.join(str(i + 1) for i in still[:8])} do not change over the training set; "
                "take more orientations, or leave them out"
            )
        return cls(values.mean(axis=0), spread)

    def to_standard(self, values: Array) -> Array:
        """(…, n) → mean 0, spread 1."""
        out: Array = (values - self.mean) / self.spread
        return out

    def from_standard(self, values: Array) -> Array:
        """The other way."""
        out: Array = values * self.spread + self.mean
        return out


@dataclass(frozen=True, slots=True)
class Perceptron:
    """The network's weights; `hidden` (h, n + 1) with the biases b last, `output` (m, h + 1) with d last.

    Inputs and outputs are in their own units, such as [T] and [N·m/A]; inside they are standardised.
    """

    hidden: Array
    output: Array
    inputs: Scaling
    outputs: Scaling

    @property
    def nodes(self) -> int:
        """Of the hidden layer."""
        return int(self.hidden.shape[0])

    def __call__(self, x: Array) -> Array:
        """(…, m) for inputs (…, n).

        >>> one = Scaling(np.zeros(1), np.ones(1))
        >>> Perceptron(np.array([[2.0, 0.0]]), np.array([[3.0, 1.0]]), one, one)(np.array([[0.0], [10.0]])).tolist()
        [[1.0], [4.0]]
        """
        if x.shape[-1] != self.hidden.shape[1] - 1:
            raise InputError(f"the network takes {self.hidden.shape[1] - 1} inputs; got {x.shape[-1]}")
        h = np.tanh(self.inputs.to_standard(check_finite(x, "inputs")) @ self.hidden[:, :-1].T + self.hidden[:, -1])
        return self.outputs.from_standard(h @ self.output[:, :-1].T + self.output[:, -1])

    def fold_scalings(self) -> tuple[Array, Array]:
        """(hidden, output) that take inputs and give outputs in their own units: both scalings multiplied in.

        Weights are standardised numbers over the inputs' units.
        """
        hidden, output = self.hidden.copy(), self.output.copy()
        hidden[:, :-1] /= self.inputs.spread
        hidden[:, -1] -= hidden[:, :-1] @ self.inputs.mean
        output *= self.outputs.spread[:, None]
        output[:, -1] += self.outputs.mean
        return hidden, output
