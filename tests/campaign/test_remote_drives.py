from __future__ import annotations

import sys
from pathlib import Path

import pytest

from labpipe.campaign.remote_drives import is_on_this_machine, shared_kind

MOUNTS = """\
22 1 8:1 / / rw,relatime - ext4 /dev/sda1 rw
30 22 0:40 / /mnt/lab rw shared:1 - nfs4 server:/lab rw
31 30 0:41 / /mnt/lab/own\\040disk rw - xfs /dev/sdb rw
no mount at all
32 22 0:42 / /mnt/win rw - cifs //server/share rw
"""


@pytest.mark.parametrize(
    ("path", "kind"),
    [
        ("/processed/C", "ext4"),
        ("/mnt/lab/processed/C", "nfs4"),
        ("/mnt/lab", "nfs4"),
        ("/mnt/laboratory", "ext4"),
        ("/mnt/lab/own disk/C", "xfs"),
        ("/mnt/win/C", "cifs"),
    ],
)
def test_the_deepest_mount_counts(path: str, kind: str) -> None:
    assert shared_kind(MOUNTS, path) == kind


def test_nothing_is_known_of_an_odd_table() -> None:
    assert shared_kind("", "/x") == ""


@pytest.mark.skipif(sys.platform != "linux", reason="the table of mounts is that of Linux")
def test_a_shared_drive_is_not_of_this_machine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert is_on_this_machine(Path("/proc").resolve())
    for kind, own in (("nfs4", False), ("fuse.sshfs", False), ("", False), ("ext4", True)):
        monkeypatch.setattr("labpipe.campaign.remote_drives.shared_kind", lambda *_, k=kind: k)
        assert is_on_this_machine(tmp_path) is own
