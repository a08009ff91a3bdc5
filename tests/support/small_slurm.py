"""A Slurm of two nodes on this machine, as processes of root: munged, slurmctld, two slurmd.

Needs Debian's packages slurmctld, slurmd, slurm-client and munge. Each node has two CPUs, whether
the machine has them or not.
"""

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import time
from pathlib import Path

NODES = ("n1", "n2")
REASON = "needs root and Debian's packages slurmctld, slurmd, slurm-client and munge"
CONF = """\
ClusterName=small
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={ports[0]}
SlurmUser=root
AuthType=auth/munge
AuthInfo=socket={folder}/munge/socket
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool/%n
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/%n.pid
ProctrackType=proctrack/linuxproc
TaskPlugin=task/affinity
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
ReturnToService=2
NodeName=n1 NodeHostname={host} NodeAddr=127.0.0.1 Port={ports[1]} CPUs=2 State=UNKNOWN
NodeName=n2 NodeHostname={host} NodeAddr=127.0.0.1 Port={ports[2]} CPUs=2 State=UNKNOWN
PartitionName=main Nodes=n1,n2 Default=YES MaxTime=INFINITE State=UP
"""


def is_possible():
    """Whether `started` can start one."""
    programs = ("munged", "slurmctld", "slurmd", "sbatch", "srun", "scontrol")
    path = f"{os.environ.get('PATH', '')}:/usr/sbin"
    return os.geteuid() == 0 and all(shutil.which(each, path=path) for each in programs)


@contextlib.contextmanager
def started(folder):
    """The environment variables of its clients; `folder` is an empty one with a short path."""
    folder = Path(folder)
    for name in ("munge", "state", "spool"):
        (folder / name).mkdir()
    (folder / "munge").chmod(0o700)
    key = folder / "munge" / "key"
    key.write_bytes(os.urandom(128))
    key.chmod(0o600)
    with contextlib.ExitStack() as stack:
        frees = [stack.enter_context(socket.create_server(("127.0.0.1", 0))) for _ in range(3)]
        ports = [free.getsockname()[1] for free in frees]
    conf = folder / "slurm.conf"
    host = socket.gethostname().partition(".")[0]
    conf.write_text(CONF.format(host=host, folder=folder, ports=ports))
    munge = ["munged", "--force", "--foreground"]
    munge += [
        f"--{name}={folder}/munge/{file}"
        for name, file in {
            "key-file": "key",
            "socket": "socket",
            "pid-file": "pid",
            "log-file": "log",
            "seed-file": "seed",
        }.items()
    ]
    variables = {"SLURM_CONF": str(conf)}
    path = {"PATH": f"{os.environ['PATH']}:/usr/sbin"}
    with contextlib.ExitStack() as stack:

        def start(name, words):
            log = stack.enter_context(open(folder / f"{name}.log", "wb"))
            process = subprocess.Popen(
                words,
                env={**os.environ, **variables, **path},
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
            stack.callback(_end, process)

        start("munged", munge)
        _wait(lambda: (folder / "munge" / "socket").exists())
        start("slurmctld", ["slurmctld", "-D"])
        for node in NODES:
            start(node, ["slurmd", "-D", "-N", node])
        _wait(lambda: said(variables, "sinfo", "-h", "-o", "%T %D") == "idle 2")
        try:
            yield variables
        finally:
            said(variables, "scancel", "--user=root")
            _wait(lambda: said(variables, "squeue", "-h") == "")


def said(variables, *words):
    """What a client's program prints; "" where it fails."""
    done = subprocess.run(
        words, env={**os.environ, **variables}, capture_output=True, text=True, timeout=60
    )
    return done.stdout.strip() if done.returncode == 0 else ""


def submitted(variables, script, words, options):
    """The number of a job that sbatch has queued."""
    done = subprocess.run(
        ["sbatch", "--parsable", *options, str(script), *map(str, words)],
        env={**os.environ, **variables},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def wait_until_ended(variables, seconds=300):
    """Wait until no job is queued or runs."""
    _wait(lambda: said(variables, "squeue", "-h") == "", seconds)


def _wait(is_so, seconds=60):
    end = time.monotonic() + seconds
    while not is_so():
        assert time.monotonic() < end, "Slurm has not come as far in time"
        time.sleep(0.2)


def _end(process):
    process.send_signal(signal.SIGTERM)
    try:
        process.wait(20)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
