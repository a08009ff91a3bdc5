"""The same meshes shown twice in one run: does memory grow, or does it follow the mesh in use?

    PYTHONPATH=. python tests/endurance/same_meshes_twice.py docs/jobs/same-meshes-twice.json
    --out DIR [--most-growth 0.03]

writes the meshes of JOB's shapes into DIR/meshes, in JOB's order, and renders them with one worker
into DIR/data twice in one run: first all of them as they are, and then all of them once more,
laid on their sides, so that they are other shapes of as many triangles. It
looks at the run once per second (many_pictures.py) and compares the memory while a mesh is in use
the second time with that of the first time. DIR/report.json, DIR/report.md and DIR/chart.png are
written. It fails if the job does, or if memory grows by more than the limit.

growth   mean over the meshes of the relative difference, after the first hundred pictures, with
         its 95 % interval (Student's t, meshes as the unit)
growth_of_later   the same of the meshes that are first shown after a tenth of the pictures: during
         the others, processes that read meshes are still there
by the usual measure   the last tenth of the pictures beside the tenth after the first hundred, as
         in many_pictures.py, where the meshes in use differ
"""

import argparse
import sys
from pathlib import Path

import msgspec
import numpy as np
from scipy.stats import t as student

from factory.planning.jobs import load
from factory.planning.shape_names import list_sources
from factory.shapes.catalogue import load as load_mesh
from manifests.files import write_figure, write_json, write_text
from manifests.provenance import provenance, shorten
from manifests.store import Store
from tests.endurance.many_pictures import COLUMNS, FIRST, growth, watched

LAID = "up=y"  # a reading option; without it a PLY file's z points up


def written(mesh, path):
    """Write a mesh's triangles as a binary PLY file."""
    corners = np.ascontiguousarray(mesh.vertices, "<f4")
    faces = np.empty(len(mesh.faces), [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, mesh.faces
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(corners)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    path.write_bytes(header.encode() + corners.tobytes() + faces.tobytes())


def doubled(job, folder):
    """Write the meshes of a job below a folder; (the job of them twice, {name: triangles})."""
    meshes = folder / "meshes"
    meshes.mkdir()
    first, second, triangles = [], [], {}
    for number, source in enumerate(list_sources(job, folder)):
        mesh = load_mesh(source.place)
        name = f"{number:02d}-{source.place.replace(':', '-')}"
        written(mesh, meshes / f"{name}.ply")
        (meshes / f"{name}-laid.ply").hardlink_to(meshes / f"{name}.ply")
        first.append(f"meshes/{name}.ply")
        second.append(f"meshes/{name}-laid.ply?{LAID}")
        triangles[name] = len(mesh.faces)
    return msgspec.structs.replace(job, shapes=(*first, *second)), triangles


def by_mesh(rows, shapes, names):
    """Median memory (2, meshes) while each mesh is in use, both times; NaN without a sample.

    shapes  of the pictures, in the order in which they were made
    names   of the meshes
    The first look at a mesh is left out: it may see the mesh before, or both.
    """
    result = np.full((2, len(names)), np.nan)
    made = rows[:, 1].astype(int)
    in_use = np.array([shapes[min(k, len(shapes) - 1)] for k in made])
    for time, ending in enumerate(("", "-laid")):
        for k, name in enumerate(names):
            looks = rows[(in_use == name + ending) & (made >= FIRST), 2][1:]
            if len(looks):
                result[time, k] = np.median(looks)
    return result


def mean_growth(memory):
    """(mean, low, high) of the relative growth from the first time to the second, over meshes."""
    relative = memory[1] / memory[0] - 1
    relative = relative[np.isfinite(relative)]
    if len(relative) < 3:
        raise SystemExit(f"expected looks at three meshes both times, found {len(relative)}")
    mean = float(relative.mean())
    half = float(
        student.ppf(0.975, len(relative) - 1) * relative.std(ddof=1) / np.sqrt(len(relative))
    )
    return mean, mean - half, mean + half


def chart(rows, memory, triangles):
    """A figure of memory over the number of pictures, and of the second time over the first."""
    from matplotlib.figure import Figure

    drawing = Figure(figsize=(10, 4), layout="constrained")
    left, right = drawing.subplots(1, 2)
    left.plot(rows[:, 1], rows[:, 2], lw=1)
    left.set(xlabel="pictures", ylabel="memory (MB)", ylim=(0, None))
    for label, values in zip(("first time", "second time"), memory, strict=True):
        right.plot(
            np.array(list(triangles.values())) / 1000, values, "o", ms=4, alpha=0.7, label=label
        )
    right.set(xlabel="thousand triangles of the mesh in use", ylabel="memory (MB)")
    right.legend()
    for axes in (left, right):
        axes.grid(alpha=0.3)
    return drawing


def main():
    """Run it and write the report; 0 if memory does not grow."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("job", metavar="JOB")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--most-growth", type=float, default=0.03, metavar="SHARE")
    options = parser.parse_args()
    data, temporary = options.out / "data", options.out / "temporary"
    if options.out.exists():
        raise SystemExit(f"{options.out}: expected a new folder, found one (name another --out)")
    temporary.mkdir(parents=True)
    words = " ".join(map(shorten, sys.argv[1:]))
    made_by = provenance(f"PYTHONPATH=. python tests/endurance/same_meshes_twice.py {words}")
    job, triangles = doubled(load(options.job)[0], options.out)
    path = options.out / "job.json"
    path.write_bytes(msgspec.json.encode(job))
    command = [sys.executable, "-m", "factory", "render", str(path), "--out", str(data)]
    command += ["--workers", "1"]
    status, rows = watched(command, data, temporary, options.out / "run.log")
    table = np.array(rows)
    shapes = [record.shape for record in Store(data).records()]
    memory = by_mesh(table, shapes, list(triangles))
    mean, low, high = mean_growth(memory)
    later = mean_growth(memory[:, -(-2 * len(triangles) // 10) :])
    result = {
        **made_by,
        "exit_status": status,
        "pictures": sum(1 for _ in (data / "images").rglob("*.exr")),
        "seconds": float(table[-1, 0]),
        "growth": {"mean": mean, "low": low, "high": high},
        "growth_of_later": dict(zip(("mean", "low", "high"), later, strict=True)),
        "growth_by_tenths": growth(table, 2),
        "handles_growth": growth(table, 3),
        "most_memory_mb": float(table[:, 2].max()),
        "meshes": [
            {
                "shape": name,
                "triangles": number,
                "memory_mb": [None if np.isnan(v) else round(float(v), 1) for v in values],
            }
            for name, number, values in zip(triangles, triangles.values(), memory.T, strict=True)
        ],
        "columns": COLUMNS,
        "rows": [list(row) for row in rows[:: max(1, len(rows) // 400)]],
    }
    write_json(options.out / "report.json", result)
    write_figure(options.out / "chart.png", chart(table, memory, triangles), dpi=100)
    lines = [
        "# The same meshes twice in one run",
        "",
        f"    {result['command']}",
        "",
        f"Commit {result['commit']}, {result['date']}, {result['machine']}.",
        "",
        "![chart](chart.png)",
        "",
        "| | |",
        "|---|---|",
        f"| pictures; meshes, of which the memory is known both times |"
        f" {result['pictures']}; {np.isfinite(memory).all(0).sum()} of {len(triangles)} |",
        f"| seconds | {result['seconds']:.0f} |",
        "| memory while a mesh is in use the second time, beside the first |"
        f" {mean:+.1%} [{low:+.1%}, {high:+.1%}] |",
        "| the same, of meshes that are first shown after a tenth of the pictures |"
        f" {later[0]:+.1%} [{later[1]:+.1%}, {later[2]:+.1%}] |",
        "| last tenth of the pictures beside the tenth after the first hundred, of other meshes |"
        f" {result['growth_by_tenths']:+.1%} |",
        f"| growth of open files | {result['handles_growth']:+.1%} |",
        f"| most memory | {result['most_memory_mb']:.0f} MB |",
    ]
    write_text(options.out / "report.md", "\n".join(lines) + "\n")
    print("\n".join(lines[-7:]))
    return 0 if status == 0 and max(mean, later[0]) <= options.most_growth else 1


if __name__ == "__main__":
    sys.exit(main())
