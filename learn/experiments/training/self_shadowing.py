"""Measure what the shadows of relit training pictures leave of the difference to full transport.

The layer's pictures have neither self-shadowing nor interreflection. Training multiplies a share of
them by a factor that is computed from depth (learn.data.shadows). Here this is done to pictures
that Cycles rendered at full light transport: of each the display L2 is measured of the layer's
picture from the true normals, material and light, of the same with the factor, and of Cycles' own
pictures of the direct and the shadow tier, where the data set has them. The data sets of the ladder
have all three (`python -m learn evaluate-ladder --jobs DIR` names them). rows.jsonl keeps a line
per picture: the same command continues.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from learn.commands import options
from learn.experiments import runner

if TYPE_CHECKING:
    import numpy as np

    from learn.data.records import Records
    from manifests.schema import Record

ON_RAY = True
PICTURES = {
    "layer": "the layer, no shadows",
    "shadowed": "the layer, with training's shadows",
    "direct": "Cycles, direct tier",
    "shadow": "Cycles, shadow tier",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the data and the number of pictures."""
    options.add_data(parser, "a data set with pictures of the full and other tiers")
    options.add_count(parser, "--pictures", 60, "of pictures")


def measure(arguments: argparse.Namespace) -> runner.Report:
    """Return {"rows": [{"picture", "shape", "light", PICTURES: display L2 or None}]}."""
    import torch

    from learn.data.records import Records
    from manifests import outputs
    from manifests.store_paths import file_hash

    torch.set_num_threads(1)
    records = Records(arguments.data)
    scenes = scenes_of(records)
    about = {"data": file_hash(records.store.fetch("materials.json"))}
    outputs.pin_settings(arguments.out / "settings.json", about)
    spread = scenes[:: max(1, len(scenes) // arguments.pictures)][: arguments.pictures]
    todo = [({"picture": scene["full"].id}, scene) for scene in spread]
    rows = runner.resume(
        arguments.out / "rows.jsonl", todo, lambda scene: row_of(records, scene), "picture"
    )
    return {"rows": rows, "scenes": len(scenes)}


def scenes_of(records: Records) -> list[dict[str, Record]]:
    """Return {tier: record} of each scene that has a full picture and one of another tier.

    Cameras are upright, as the layer assumes. Raises InputError for none.
    """
    from manifests.errors import InputError

    by_scene: dict[tuple, dict[str, Record]] = {}
    for record in records.records:
        if not record.camera.roll_deg:
            key = (
                record.geometry_hash,
                record.materials,
                record.light,
                record.rotation_texels,
                record.light_resolution,
            )
            by_scene.setdefault(key, {})[record.tier] = record
    result = [scene for scene in by_scene.values() if "full" in scene and len(scene) > 1]
    if not result:
        rule = "pictures of one scene on the full tier and another"
        raise InputError(records.folder, rule, "none", "name several tiers in the job")
    return sorted(result, key=lambda scene: scene["full"].id)


def row_of(records: Records, scene: dict[str, Record]) -> dict[str, Any]:
    """Return the display L2 of each of PICTURES against the full one; None where there is none."""
    from learn.metrics.pictures import display_l2

    truth, mask = records.image(scene["full"]), records.load(scene["full"]).mask.numpy()
    pictures = layer_pictures(records, scene["full"]) | {
        tier: records.image(scene[tier]) for tier in ("direct", "shadow") if tier in scene
    }
    return {"shape": scene["full"].shape, "light": scene["full"].light} | {
        name: display_l2(pictures[name], truth, mask) if name in pictures else None
        for name in PICTURES
    }


def layer_pictures(records: Records, record: Record) -> dict[str, np.ndarray]:
    """Return the layer's picture (H, W, 3) of a record's truth, and the same with shadows."""
    import torch

    from learn.data import shadows
    from learn.data.devices import to_numpy
    from learn.layer import render
    from shaders.frames import turned_to_viewer

    sample = records.load(record)
    with torch.no_grad():
        plain = to_numpy(render(**sample.for_layer(), tolerance=5e-3)[0])
    position, view = shadows.positions(sample.depth.numpy(), record.camera)
    n = sample.n.numpy()
    factor = shadows.shadow_factor(
        n if sample.view is None else turned_to_viewer(n, sample.view.numpy()),
        position,
        view,
        sample.segments.numpy(),
        plain,
        sample.label.numpy(),
        sample.light.numpy(),
        sample.elevation,
    )
    return {"layer": plain, "shadowed": plain * factor}


def tables(report: runner.Report) -> str:
    """Return each picture's error, and its ratio to the layer's without shadows."""
    import numpy as np

    from learn.metrics import bootstrap

    rows = report["rows"]
    lines = []
    for key, title in PICTURES.items():
        kept = [row for row in rows if row[key] is not None]
        if kept:
            groups = bootstrap.groups_of(
                [row["shape"] for row in kept], [row["light"] for row in kept]
            )
            weights = bootstrap.draws(groups)
            mine, plain = (np.array([row[each] for row in kept]) for each in (key, "layer"))
            lines.append(
                [
                    title,
                    str(len(kept)),
                    runner.mean_interval(mine, weights, 0),
                    f"{np.median(mine):.0f}",
                    runner.interval(bootstrap.ratio(plain, mine, groups), 2),
                ]
            )
    head = ["picture", "pictures", "display L2, mean", "median", "ratio to no shadows"]
    return (
        "# Shadows of relit pictures\n\n"
        f"Errors against Cycles at full light transport, on {len(rows)} pictures."
        " Intervals are over shapes and lights.\n\n" + runner.table(head, lines)
    )
