"""The Slurm batch scripts: their syntax, the commands that they give, with stand-ins for Slurm's
programs, and an array on a Slurm of this machine where one can be started.
"""

import json
import os
import re
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from manifests.store import Store
from manifests.verification import faults_of
from tests.support import small_slurm

SCRIPTS = ("ray-cluster.sh", "job-array.sh")


@pytest.fixture
def folder(root):
    """The folder of the scripts."""
    return root / "docs" / "jobs" / "slurm"


@pytest.fixture
def slurm(tmp_path):
    """Environment with stand-ins: srun runs its command here, python writes its words to `log`.

    `start --block` waits until it is killed, as Ray's does.
    """
    programs = {
        "scontrol": 'printf "node1\\nnode2\\nnode3\\n"',
        "srun": (
            'for word in "$@"; do case "$word" in --nodelist=*) node=${word#*=};; esac; done\n'
            'while case "$1" in --*) true;; *) false;; esac; do shift; done\n'
            'NODE=$node exec "$@"'
        ),
        "python": (
            'if [ "$1" = -c ]; then echo 10.0.0.1; exit; fi\n'
            'echo "${NODE:-batch}: $*" >> "$LOG"\n'
            'echo "$RAY_AUTH_MODE $RAY_AUTH_TOKEN" >> "$LOG.tokens"\n'
            'case "$*" in *--block*) echo $$ >> "$LOG.ids"; exec sleep 60;; esac\n'
            'case "$*" in *factory*) sleep 1;; esac'
        ),
    }
    for name, text in programs.items():
        path = tmp_path / "bin" / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(f"#!/bin/bash\n{text}\n")
        path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return {
        "PATH": f"{tmp_path / 'bin'}{os.pathsep}{os.environ['PATH']}",
        "PYTHON": str(tmp_path / "bin" / "python"),
        "LOG": str(tmp_path / "log"),
        "SLURM_JOB_NODELIST": "node[1-3]",
        "SLURM_CPUS_PER_TASK": "8",
    }


def run(script, words, environment):
    return subprocess.run(
        ["bash", script, *words], env=environment, capture_output=True, text=True, timeout=60
    )


@pytest.mark.parametrize("name", SCRIPTS)
def test_the_syntax_is_right_and_arguments_are_needed(folder, slurm, name):
    assert subprocess.run(["bash", "-n", folder / name], check=False).returncode == 0
    done = run(folder / name, ["job.json"], slurm)
    assert done.returncode == 2 and "usage:" in done.stderr and not Path(slurm["LOG"]).exists()


def test_a_ray_cluster_is_started_used_and_ended(folder, slurm):
    done = run(folder / "ray-cluster.sh", ["job.json", "out", "--limit", "9"], slurm)
    assert done.returncode == 0, done.stderr
    log = Path(slurm["LOG"]).read_text().splitlines()
    started = sorted(line for line in log if " start " in line)
    assert [line.split(":")[0] for line in started] == ["node1", "node2", "node3"]
    assert (
        "--head --port=6379 --node-ip-address=10.0.0.1" in started[0]
        and "--num-cpus=8" in started[0]
    )
    assert all("--address=10.0.0.1:6379" in line for line in started[1:])
    words = "-m factory render job.json --out out --ray 10.0.0.1:6379 --limit 9"
    # nodes may join while the job runs; Ray's own head answers before it begins
    assert [line for line in log if "-m factory" in line] == [f"batch: {words}"]
    tokens = set(Path(slurm["LOG"] + ".tokens").read_text().splitlines())
    assert len(tokens) == 1 and re.fullmatch(r"token [0-9a-f]{64}", tokens.pop())
    for process in Path(slurm["LOG"] + ".ids").read_text().split():
        assert not Path(f"/proc/{process}").exists()


def test_a_task_of_an_array_renders_its_part(folder, slurm):
    array = {
        "SLURM_ARRAY_TASK_ID": "3",
        "SLURM_ARRAY_TASK_COUNT": "8",
        "SLURM_ARRAY_TASK_MIN": "1",
        "SLURM_ARRAY_TASK_MAX": "8",
    }
    done = run(folder / "job-array.sh", ["job.json", "out", "--device", "cpu"], slurm | array)
    assert done.returncode == 0, done.stderr
    words = "-m factory render job.json --out out --shard 3/8 --workers 8 --device cpu"
    assert Path(slurm["LOG"]).read_text().splitlines() == [f"batch: {words}"]


@pytest.mark.parametrize(
    "array",
    [
        {},
        {"SLURM_ARRAY_TASK_MIN": "0", "SLURM_ARRAY_TASK_MAX": "7", "SLURM_ARRAY_TASK_COUNT": "8"},
        {"SLURM_ARRAY_TASK_MIN": "1", "SLURM_ARRAY_TASK_MAX": "9", "SLURM_ARRAY_TASK_COUNT": "5"},
    ],
)
def test_an_array_whose_parts_are_not_the_job_is_refused(folder, slurm, array):
    done = run(folder / "job-array.sh", ["job.json", "out"], slurm | array)
    assert done.returncode == 2 and "--array=1-N" in done.stderr


@pytest.mark.blender
@pytest.mark.long
def test_an_array_renders_on_a_slurm_and_continues_after_a_lost_task(monkeypatch, folder, root):
    """tests/endurance/slurm_losses.py has more losses, and the Ray cluster."""
    if not small_slurm.is_possible():
        pytest.skip(small_slurm.REASON)
    monkeypatch.setenv("PYTHONPATH", str(root))
    monkeypatch.setenv("PYTHON", sys.executable)
    job = {
        "shapes": ["cube", "blob:0"],
        "materials": ["brass"],
        "lights": ["city"],
        "views": [0, 6, 12, 18],
        "samples": 1,
        "camera": {"size": [16, 16]},
    }
    # paths of sockets are short
    with tempfile.TemporaryDirectory(prefix="slurm-") as name:
        own, out = Path(name), Path(name) / "out"
        (own / "job.json").write_text(json.dumps(job))
        words = [own / "job.json", out]
        (own / "slurm").mkdir()
        with small_slurm.started(own / "slurm") as slurm:
            for lost in (True, False):
                options = ["--array=1-2", f"--output={own}/%A_%a.txt"]
                small_slurm.submitted(slurm, folder / "job-array.sh", words, options)
                small_slurm.wait_until_ended(slurm)
                said = "\n".join(path.read_text() for path in sorted(own.glob("*.txt")))
                ids = [record.id for record in Store(out).records()]
                assert len(ids) == len(set(ids)) == 8 and faults_of(Store(out)) == [], said
                if lost:  # what one task has made
                    Store(out).record_files()[0].unlink()
                    assert len(list(Store(out).records())) == 4
