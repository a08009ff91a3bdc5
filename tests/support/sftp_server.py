"""An SSH server (asyncssh) that serves files and nothing else, as a process of its own.

    PYTHON tests/support/sftp_server.py PORT FOLDER

FOLDER gets home/.ssh, of a user whom the server lets in and who knows its key; `ready` is printed
once it listens. PYTHON is that of `make store-servers`.
"""

import asyncio
import sys
from pathlib import Path

import asyncssh


async def serve(port, folder):
    keys = folder / "home" / ".ssh"
    keys.mkdir(parents=True, exist_ok=True)
    host, user = (asyncssh.generate_private_key("ssh-ed25519") for _ in range(2))
    user.write_private_key(keys / "id_ed25519")
    (keys / "id_ed25519").chmod(0o600)
    user.write_public_key(folder / "authorized")
    public = host.export_public_key().decode()
    (keys / "known_hosts").write_text(f"[127.0.0.1]:{port} {public}")
    await asyncssh.listen(
        "127.0.0.1",
        port,
        server_host_keys=[host],
        authorized_client_keys=str(folder / "authorized"),
        sftp_factory=True,
    )
    print("ready", flush=True)
    await asyncio.Event().wait()


asyncio.run(serve(int(sys.argv[1]), Path(sys.argv[2])))
