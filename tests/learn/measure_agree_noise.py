"""Compare the standard errors that `learn agree` states with the scatter of many seeds.

PYTHONPATH=. python tests/learn/measure_agree_noise.py DIR [--seeds 2]

DIR is a data set whose job has many repeats, of points in the direct tier. Its pictures are divided
into groups of --seeds pictures of one condition. Printed are, over the pixels inside and over the
whole mask (with what Cycles does at facets), the mean and the scatter of the mean figure, and the
standard error as the groups state it, root mean square. Last comes the excess kurtosis of the noise
at a pixel, 0 of normal noise, mean over pixels and pictures.
"""

import argparse
from pathlib import Path

import numpy as np

from learn.agreement import facets
from learn.agreement.measure import render_sample
from learn.agreement.scenes import scenes
from learn.data.records import Records
from learn.metrics.pictures import squared_net_of_noise, standard_error_net_of_noise
from shaders import tone


def excess_kurtosis(values: np.ndarray) -> np.ndarray:
    """Return the excess kurtosis of values (S, P) over S, without its bias for normal values."""
    count = len(values)
    centred = values - values.mean(0)
    ratio = (centred**4).mean(0) / np.maximum((centred**2).mean(0) ** 2, 1e-12)
    return ratio - 3 * (count - 1) / (count + 1)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seeds", type=int, default=2)
    options = parser.parse_args()
    records = Records(options.folder)
    figures: dict[str, list] = {"inside": [], "whole mask": []}
    kurtosis = []
    for scene in scenes(records.records):
        (condition,) = scene
        sample = records.load(condition.records[0])
        entries = [records.material(name) for name in condition.records[0].materials]
        layer, forms = (
            render_sample(sample, 4e-3),
            facets.closed_forms(sample, [entry.mixture for entry in entries]),
        )
        assert forms is not None
        expected = np.maximum(forms.predicted(layer.integral)[2], 0)
        pictures = np.stack([records.image(record) for record in condition.records]).astype(float)
        count = len(pictures) // options.seeds
        groups = pictures[: count * options.seeds].reshape(count, options.seeds, *expected.shape)
        for name, where, reference in (
            ("inside", layer.inner, layer.footprint),
            ("whole mask", layer.mask, expected),
        ):
            row = []
            for group in groups:
                exposure = tone.auto_exposure(group.mean(0), layer.mask)
                D_C, D = (tone.display(each, exposure) for each in (group, reference))
                errors = (D_C - D)[:, where]
                row.append(
                    (squared_net_of_noise(errors).mean(), standard_error_net_of_noise(errors))
                )
            figures[name].append(row)
        exposure = tone.auto_exposure(pictures.mean(0), layer.mask)
        display = tone.display(pictures, exposure)[:, layer.mask].mean(-1)
        kurtosis.append(excess_kurtosis(display).mean())
    for name, rows in figures.items():
        values, errors = np.moveaxis(np.array(rows), -1, 0)  # each (pictures, groups)
        scatter = np.sqrt(values.var(1, ddof=1).sum()) / len(values)
        stated = np.sqrt((errors**2).mean(1).sum()) / len(values)
        print(
            f"{name}: {len(values)} scenes, {values.shape[1]} groups; mean {values.mean():.3f},"
            f" scatter {scatter:.3f}, standard error {stated:.3f}"
        )
    print(f"excess kurtosis {np.mean(kurtosis):.2f}")


if __name__ == "__main__":
    main()
