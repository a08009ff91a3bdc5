"""A network's forward and backward pass as CUDA graphs, which are launched as a whole.

A step of a small network is hundreds of short kernels, and launching them one by one takes longer
than they compute. A graph is recorded once, for one size of batch, and repeated.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import cast

import torch
from torch import nn

from learn.data import devices
from learn.data.batch import ExampleBatch
from learn.networks.prediction import Coded, Prediction


class _Parts(nn.Module):
    """A network's prediction of some parts as a plain tuple, which a graph can return."""

    def __init__(self, network: Coded, parts: Sequence[str], mixed_precision: bool):
        super().__init__()
        self.network, self.parts, self.mixed_precision = network, tuple(parts), mixed_precision

    def forward(self, image: torch.Tensor, mask: torch.Tensor) -> tuple[torch.Tensor, ...]:
        # the cache of autocast would outlive the graph
        with devices.mixed_precision(image.device, self.mixed_precision, cached=False):
            prediction = self.network(image, mask, None, self.parts, None, 1)
        return tuple(part for part in prediction if part is not None)


class RecordedNetwork:
    """Predicts as the network in training does, by graphs of one batch's size and some parts.

    Gradients reach the network's own weights, and its running statistics move, as without graphs.
    Tensors of a prediction are overwritten by the next one.
    """

    def __init__(
        self, network: Coded, batch: ExampleBatch, parts: Sequence[str], mixed_precision: bool
    ):
        network.train()
        before = [buffer.clone() for buffer in network.buffers()]
        example = batch.image.clone(), batch.mask.clone()
        plain = _Parts(network, parts, mixed_precision)
        with torch.no_grad():
            prediction = network(*example, None, tuple(parts), None, 1)
        self.given = [part is not None for part in prediction]
        self.shape, self.parts = batch.image.shape, tuple(parts)
        graphs = torch.cuda.make_graphed_callables(plain, example, allow_unused_input=True)
        self._graphs = cast(Callable[..., Iterable[torch.Tensor]], graphs)
        for buffer, old in zip(network.buffers(), before, strict=True):
            buffer.copy_(old)

    def serves(self, batch: ExampleBatch, parts: Sequence[str]) -> bool:
        """Return whether the graphs are of this batch's size and these parts."""
        return batch.image.shape == self.shape and tuple(parts) == self.parts

    def predict(self, batch: ExampleBatch) -> Prediction:
        """Return a Prediction of a batch that `serves` accepts."""
        results: Iterator[torch.Tensor] = iter(self._graphs(batch.image, batch.mask))
        return Prediction(*(next(results) if given else None for given in self.given))
