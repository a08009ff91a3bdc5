"""Initialises a network: by weights of an earlier run, an encoder from a package, other heads."""

from learn.data.seen import Seen, read_seen
from learn.data.settings import Run
from learn.networks import tensor_file, weights
from learn.networks.joint_encoders import JointEncoders
from learn.networks.prediction import Coded
from learn.networks.pretrained import CompactPretrained, encoder_weights
from learn.networks.two_encoders import TwoEncoders


def initialise(network: Coded, run: Run, seen: Seen) -> Seen:
    """Give a new network the tensors that its run names; all others keep their random values.

    seen     what this run draws from
    Returns  the same and what the weights that it begins with saw
    Raises   InputError: weights of another network; tensors that are missing, of other shapes or
             not finite; a package that is not installed
    """
    if run.start is not None:
        with tensor_file.open_tensor_file(run.start) as stored:
            own = stored.metadata.get("network") == network.name
            if isinstance(network, JointEncoders) and not own:
                weights.fill_joint(network, stored)
            else:
                weights.require_network(stored, network)
                weights.fill(network, stored)
            seen = seen.join(read_seen(stored.metadata, run.start))
    elif isinstance(network, CompactPretrained):
        network.take_encoder(encoder_weights())
    elif isinstance(network, (TwoEncoders, JointEncoders)):
        network.of_normals.take_encoder(encoder_weights())
    if run.heads is not None:
        with tensor_file.open_tensor_file(run.heads) as stored:
            weights.fill_heads(network, stored)
            seen = seen.join(read_seen(stored.metadata, run.heads))
    return seen
