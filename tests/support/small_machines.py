"""Machines of their own kernel on this one, by User-mode Linux, that share a folder by NFS.

Each is a process that boots a Linux kernel, sees this machine's files at the same paths, and is on
a network with the others. One of them has a disk and exports it; the others mount it. Debian's
packages user-mode-linux, uml-utilities, nfs-kernel-server, kmod and iproute2 have all of it, and
root may start them.
"""

import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

PROGRAMS = ("linux.uml", "uml_switch", "modprobe", "ip", "rpc.nfsd", "mount.nfs", "mkfs.ext4")
MODULES = Path("/usr/lib/uml/modules")
SHARE = "/tmp/share"  # where the machines but the server mount the shared folder
BOOT = """#!/bin/bash
export PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root
mount -t proc proc /proc; mount -t sysfs sys /sys; mount -t devtmpfs dev /dev 2>/dev/null
mkdir -p /dev/pts /dev/shm; mount -t devpts pts /dev/pts; mount -t tmpfs shm /dev/shm
mount -t tmpfs run /run; mount -t tmpfs lib /var/lib/nfs; mount -t tmpfs tmp /tmp
mount --bind {modules} /lib/modules
name=$(sed 's/.*machine=\\([a-z0-9]*\\).*/\\1/' /proc/cmdline)
exec > {folder}/$name.log 2>&1
hostname "$(cat {folder}/$name.hostname)"  # by which a server of NFS 4 tells its clients apart
ip link set lo up
ip addr add 10.77.0.$(cat {folder}/$name.number)/24 dev eth0; ip link set eth0 up
if [ $name = server ]; then
  mkdir -p /tmp/disk /run/rpcbind /var/lib/nfs/sm /var/lib/nfs/rpc_pipefs /var/lib/nfs/v4recovery
  mount -t ext4 /dev/ubda /tmp/disk; mkdir -p /tmp/disk/share
  modprobe nfsd; mount -t nfsd nfsd /proc/fs/nfsd
  touch /var/lib/nfs/etab /var/lib/nfs/rmtab; rpcbind -w
  exportfs -o rw,no_root_squash,fsid=0,insecure,no_subtree_check 10.77.0.0/24:/tmp/disk/share
  rpc.nfsd -N 3 4 && rpc.mountd -N 3 && touch {folder}/$name.ready
else
  modprobe nfsv4; mkdir -p {share}
  until mount -t nfs -o vers=4.2 10.77.0.1:/ {share}; do sleep 1; done
  touch {folder}/$name.ready
fi
while [ ! -e {folder}/$name.end ]; do
  for each in {folder}/$name.*.sh; do
    [ -e "$each" ] || continue
    mv "$each" "$each.begun"
    (bash "$each.begun" > "$each.out" 2>&1; echo $? > "$each.status.new"
     mv "$each.status.new" "$each.status") &
  done
  sleep 0.2
done
sync; echo o > /proc/sysrq-trigger; sleep 5
"""


def missing():
    """The programs that are not installed; all of them where machines may not be started."""
    if os.geteuid() or not MODULES.is_dir():
        return list(PROGRAMS)
    path = os.environ.get("PATH", "") + ":/usr/sbin:/sbin"
    return [name for name in PROGRAMS if shutil.which(name, path=path) is None]


class Network:
    """Some machines: a server with a disk of so many MB, and others that mount it.

    folder  for their logs, commands and the disk; not in the shared folder
    host    the host name of all others, if each is not to have its own
    """

    def __init__(
        self, folder: Path, others: int, host: str = "", disk_mb: int = 600, memory_mb: int = 400
    ):
        self.folder, self._memory = Path(folder).resolve(), memory_mb
        self.folder.mkdir(parents=True)
        Path("/lib/modules").mkdir(exist_ok=True)  # where machines look for theirs
        words = {"modules": MODULES, "folder": self.folder, "share": SHARE}
        boot = self.folder / "boot.sh"
        text = BOOT
        for name, value in words.items():
            text = text.replace(f"{{{name}}}", str(value))
        boot.write_text(text)
        boot.chmod(0o755)
        disk = self.folder / "disk.image"
        with open(disk, "wb") as file:
            file.truncate(disk_mb << 20)
        subprocess.run(["/sbin/mkfs.ext4", "-q", "-F", str(disk)], check=True)
        self._switch = subprocess.Popen(
            ["uml_switch", "-unix", str(self.folder / "switch")],
            stdin=subprocess.PIPE,  # it ends where its input does
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        self._processes, self._given = {}, 0
        self.names = [f"machine{k + 1}" for k in range(others)]
        try:
            for name in ("server", *self.names):
                self.start(name, host if name != "server" else "")
        except BaseException:
            self.close()
            raise

    def start(self, name: str, host: str = "", patience: float = 120.0) -> None:
        """Start a machine and wait until it is on the network and has the shared folder.

        host  its host name, if it is not `name`
        """
        (self.folder / f"{name}.hostname").write_text(host or name)
        number = 1 if name == "server" else 2 + self.names.index(name)
        (self.folder / f"{name}.number").write_text(str(number))
        ready = self.folder / f"{name}.ready"
        ready.unlink(missing_ok=True)
        words = ["linux.uml", "rootfstype=hostfs", "rootflags=/", "rw", f"mem={self._memory}M"]
        words += [f"umid={name}", f"uml_dir={self.folder}/", f"init={self.folder / 'boot.sh'}"]
        words += [f"eth0=daemon,,unix,{self.folder / 'switch'}", "con=null", "ssl=null"]
        words += [f"ubd0={self.folder / 'disk.image'}"] if name == "server" else []
        with open(self.folder / f"{name}.boot.log", "wb") as log:
            self._processes[name] = subprocess.Popen(
                [*words, "con0=null,fd:2", f"machine={name}"],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
        end = time.monotonic() + patience
        while not ready.exists():
            if time.monotonic() > end or self._processes[name].poll() is not None:
                raise OSError(f"the machine {name} did not start (see {self.folder}/{name}.log)")
            time.sleep(0.1)

    def begin(self, name: str, command: str) -> Path:
        """Let a machine run a command of its shell; return what `status` and `said` take."""
        self._given += 1
        path = self.folder / f"{name}.{self._given}.sh"
        draft = path.with_suffix(".draft")
        draft.write_text(command + "\n")
        draft.rename(path)
        return path

    def status(self, command: Path, patience: float = 600.0) -> int | None:
        """Wait for a command's exit status; None where it takes longer."""
        end, found = time.monotonic() + patience, Path(f"{command}.status")
        while not found.exists():
            if time.monotonic() > end:
                return None
            time.sleep(0.1)
        return int(found.read_text())

    def said(self, command: Path) -> str:
        """What a command has said so far."""
        path = Path(f"{command}.out")
        return path.read_text(errors="replace") if path.exists() else ""

    def cut_power(self, name: str) -> None:
        """End a machine without notice, in the middle of whatever it does."""
        process = self._processes.pop(name)
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()

    def close(self) -> None:
        """End all machines."""
        for name in [*self._processes][::-1]:
            process = self._processes[name]
            (self.folder / f"{name}.end").touch()
            try:
                process.wait(20)
                self._processes.pop(name)
            except subprocess.TimeoutExpired:
                self.cut_power(name)
        self._switch.kill()
        self._switch.wait()
