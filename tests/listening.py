"""Where a process listens, read from the kernel's socket table."""

from __future__ import annotations

import ipaddress
import os
import re
from pathlib import Path

Address = ipaddress.IPv4Address | ipaddress.IPv6Address

#: The state of a socket that listens, in the table.
_LISTEN = "0A"


def listening(pid: int) -> list[tuple[str, int]]:
    """Address and port of each TCP socket, of both versions of IP, on which a process listens."""
    inodes = set()
    for entry in Path(f"/proc/{pid}/fd").iterdir():
        try:
            found = re.fullmatch(r"socket:\[(\d+)\]", os.readlink(entry))  # noqa: PTH115
        except OSError:  # closed meanwhile
            continue
        if found:
            inodes.add(found[1])
    return [
        (str(address), port)
        for address, port, state, inode in _table(pid)
        if state == _LISTEN and inode in inodes
    ]


def _table(pid: int) -> list[tuple[Address, int, str, str]]:
    """The rows of the table: address and port of this side, state, inode."""
    rows = []
    for name in ("tcp", "tcp6"):
        for line in Path(f"/proc/{pid}/net/{name}").read_text().splitlines()[1:]:
            fields = line.split()
            host, port = fields[1].split(":")
            # Words of 32 bits, each in the machine's order of bytes.
            words = [bytes.fromhex(host[i : i + 8])[::-1] for i in range(0, len(host), 8)]
            rows.append(
                (ipaddress.ip_address(b"".join(words)), int(port, 16), fields[3], fields[9])
            )
    return rows
