"""Unpacking bundles within limits."""

from __future__ import annotations

import contextlib
import stat
import struct
import zipfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from raykiln_service.bundles import BundleLimits, unpack
from raykiln_service.errors import InvalidAssetError

LIMITS = BundleLimits(total_bytes=10_000_000, entries=50, ratio=100.0)


def pack(path: Path, entries: list[tuple[str, bytes]]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as bundle:
        for name, content in entries:
            bundle.writestr(name, content)
    return path


def unpacked(archive: Path, limits: BundleLimits = LIMITS) -> Path:
    folder = archive.parent / "out"
    folder.mkdir()
    unpack(archive, folder, limits)
    return folder


def test_files_come_out_as_they_went_in_and_cannot_be_changed(tmp_path: Path) -> None:
    archive = pack(tmp_path / "a.zip", [("s/scene.json", b"{}"), ("s/t/ü.bin", bytes(1000))])
    folder = unpacked(archive)
    assert (folder / "s/scene.json").read_bytes() == b"{}"
    assert (folder / "s/t/ü.bin").read_bytes() == bytes(1000)
    modes = {stat.S_IMODE(p.stat().st_mode) for p in folder.rglob("*")}
    assert modes == {0o444, 0o555}


def test_as_much_as_allowed_and_no_more(tmp_path: Path) -> None:
    entries = [(f"{i}.bin", bytes([i]) * 1000) for i in range(5)]
    archive = pack(tmp_path / "a.zip", entries)
    exact = BundleLimits(total_bytes=5000, entries=5, ratio=100.0)
    assert len(list(unpacked(archive, exact).iterdir())) == 5
    for limits, told in (
        (BundleLimits(4999, 5, 100.0), "too much"),
        (BundleLimits(5000, 4, 100.0), "too many"),
    ):
        with pytest.raises(InvalidAssetError, match=told):
            unpack(archive, tmp_path / "out2", limits)


def test_an_entry_that_says_less_than_it_holds(tmp_path: Path) -> None:
    archive = pack(tmp_path / "a.zip", [("a.bin", bytes(500_000))])
    data = bytearray(archive.read_bytes())
    record = data.rfind(b"PK\x01\x02")
    struct.pack_into("<I", data, record + 24, 10)
    archive.write_bytes(data)
    with pytest.raises(InvalidAssetError):
        unpacked(archive)
    assert sum(p.stat().st_size for p in (tmp_path / "out").rglob("*") if p.is_file()) <= 500_000


def test_a_central_directory_too_large_to_look_at(tmp_path: Path) -> None:
    archive = pack(tmp_path / "a.zip", [("a.bin", b"x")])
    data = bytearray(archive.read_bytes())
    struct.pack_into("<I", data, data.rfind(b"PK\x05\x06") + 12, 0xFFFFFFF0)
    archive.write_bytes(data)
    with pytest.raises(InvalidAssetError, match="too many entries"):
        unpacked(archive)


def test_encryption_is_refused(tmp_path: Path) -> None:
    archive = pack(tmp_path / "a.zip", [("a.bin", b"x")])
    data = bytearray(archive.read_bytes())
    data[data.rfind(b"PK\x01\x02") + 8] |= 1
    archive.write_bytes(data)
    with pytest.raises(InvalidAssetError, match="encrypted"):
        unpacked(archive)


@given(
    st.lists(
        st.text(st.sampled_from("ab./\\:\0é\n"), min_size=1, max_size=12), min_size=1, max_size=6
    )
)
def test_nothing_lands_outside(tmp_path_factory: pytest.TempPathFactory, names: list[str]) -> None:
    place = tmp_path_factory.mktemp("any")
    with zipfile.ZipFile(place / "a.zip", "w") as bundle:
        for name in dict.fromkeys(names):
            info = zipfile.ZipInfo("x")
            info.filename = name
            bundle.writestr(info, b"x")
    (place / "out").mkdir()
    with contextlib.suppress(InvalidAssetError):
        unpack(place / "a.zip", place / "out", LIMITS)
    inside = (place / "out").resolve()
    assert all(p.resolve().is_relative_to(inside) for p in inside.rglob("*"))
    assert {p.name for p in place.iterdir()} == {"a.zip", "out"}


@given(st.binary(max_size=400), st.integers(0, 400))
def test_damage_is_told_and_nothing_worse(
    tmp_path_factory: pytest.TempPathFactory, noise: bytes, at: int
) -> None:
    place = tmp_path_factory.mktemp("damaged")
    archive = pack(place / "a.zip", [("a/b.json", b"{}" * 50), ("c.bin", bytes(range(256)))])
    data = archive.read_bytes()
    archive.write_bytes(data[:at] + noise + data[at + len(noise) :])
    (place / "out").mkdir()
    with contextlib.suppress(InvalidAssetError):
        unpack(archive, place / "out", LIMITS)
