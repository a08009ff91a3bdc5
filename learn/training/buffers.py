"""A network's buffers, such as running statistics: what a step that is skipped restores."""

import torch


class StoredBuffers:
    """A copy of a network's buffers."""

    def __init__(self, network: torch.nn.Module) -> None:
        self.own = list(network.buffers())
        self.stored = [buffer.clone() for buffer in self.own]

    def store(self) -> None:
        """Copy the network's buffers."""
        self._copy(self.own, self.stored)

    def restore(self) -> None:
        """Give the network the copies."""
        self._copy(self.stored, self.own)

    def _copy(self, source: list[torch.Tensor], target: list[torch.Tensor]) -> None:
        for kind in {buffer.dtype for buffer in self.own}:  # one launch for all of a type
            torch._foreach_copy_(
                [each for each in target if each.dtype == kind],
                [each for each in source if each.dtype == kind],
            )
