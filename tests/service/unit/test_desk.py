"""What is carried from a child's desk while the child goes on writing there."""

from __future__ import annotations

import threading
from pathlib import Path

from raykiln_service.executors.desk import Desk


def test_checkpoints_are_carried_away_while_newer_ones_take_their_place(tmp_path: Path) -> None:
    desk = Desk(tmp_path)
    place = tmp_path / "checkpoint"
    stop = threading.Event()

    def write() -> None:
        number = 0
        while not stop.is_set():
            fresh = desk.path / ".fresh"
            fresh.write_text(f"{number:09}")
            fresh.replace(desk.checkpoint)
            number += 1

    writer = threading.Thread(target=write)
    writer.start()
    try:
        carried, last = 0, -1
        while carried < 300:
            if desk.take_checkpoint(place):
                text = place.read_text()
                assert len(text) == 9, "a checkpoint was carried in part"
                assert int(text) >= last, "an older checkpoint came after a newer one"
                carried, last = carried + 1, int(text)
    finally:
        stop.set()
        writer.join()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["checkpoint", desk.path.name]


def test_a_checkpoint_that_was_carried_already_leaves_nothing_behind(tmp_path: Path) -> None:
    desk = Desk(tmp_path)
    place = tmp_path / "checkpoint"
    desk.checkpoint.write_text("first")
    place.hardlink_to(desk.checkpoint)
    assert desk.take_checkpoint(place)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["checkpoint", desk.path.name]
