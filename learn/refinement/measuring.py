"""Measures learn.refinement.likely's numbers: predictions for relit pictures of the training side, beside their truth."""

import msgspec
import numpy as np
from tqdm import tqdm

from learn.evaluation.methods import network
from learn.refinement import likely
from learn.training import checkpoint, settings, sources
from learn.training.relit import Relit
from shaders import envmap

BATCH = 8


def measured(weights, data, lights, count, seed):
    """(Likely, {what it was measured on}) of `count` pictures. weights: a file; data: a dataset's folder; lights: an .npz or None."""
    net, metadata = checkpoint.load_network(weights)
    run = msgspec.convert(metadata["run"], settings.Run)
    plain = msgspec.structs.replace(run.data, photograph=False, source="relit", regions=1)
    pool = sources.pools(plain, data, lights)["train"]
    source, predict = Relit(pool, plain, BATCH, run.size, seed), network(net)
    parts = [_compared(batch, predict(batch)) for batch in (source[k] for k in tqdm(range(-(-count // BATCH)), unit="batch"))]
    samples = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    told = {"pictures": len(samples["label"]), "materials": sorted(pool.labels), "maps": len(pool.maps), "run": run.name, "seed": seed}
    return likely.fitted(samples, list(pool.labels.values())), told


def _compared(batch, prediction):
    """What likely.fitted reads, of one batch."""
    step = batch.n.shape[-1] // likely.SIDE
    found = {"inside": (batch.segments > 0)[:, step // 2 :: step, step // 2 :: step].numpy()}
    for prefix, parts in (("", batch), ("predicted_", prediction)):
        disk = parts.n[:, :2] / (1 + parts.n[:, 2:].clamp(min=0))
        found[f"{prefix}disk"] = disk[:, :, step // 2 :: step, step // 2 :: step].half().numpy()
        found[f"{prefix}label"] = parts.label[:, 0].numpy()
        lights = parts.light.movedim(1, -1).numpy()
        found[f"{prefix}light"] = np.stack([envmap.resize(L, likely.HEIGHT, likely.WIDTH) for L in lights])
    return found
