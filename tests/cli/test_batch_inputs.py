"""What a batch finds to render."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from raykiln_service.commands.batch_inputs import read_inputs
from raykiln_service.commands.console import CommandError

OUT = Path("no-such-output-folder")


def names(source: Path, folder: Path = OUT) -> list[str]:
    return [item.name for item in read_inputs(source, folder, {})]


def touch(path: Path, text: str = "") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def test_a_scene_with_its_side_files_counts_once(tmp_path: Path) -> None:
    touch(tmp_path / "room/scene.xml", '<scene><string value="models/a.obj"/></scene>')
    touch(tmp_path / "room/models/a.obj")
    touch(tmp_path / "room/textures/wood.png")
    touch(tmp_path / "car/car.gltf", '{"buffers": [{"uri": "car.bin"}]}')
    touch(tmp_path / "car/car.bin")
    touch(tmp_path / "lone.obj")
    touch(tmp_path / "lone.mtl")
    touch(tmp_path / "s.json", '{"shapes": [{"type": "mesh", "file": "m.ply"}]}')
    touch(tmp_path / "m.ply")
    assert names(tmp_path) == ["lone", "s", "car/car", "room/scene"]


def test_documents_that_are_no_scenes_are_left_out(tmp_path: Path) -> None:
    touch(tmp_path / "package.json", '{"name": "x"}')
    touch(tmp_path / "a.stats.json", '{"shapes": []}')
    touch(tmp_path / "list.json", "[1]")
    touch(tmp_path / "feed.xml", "<?xml version='1.0'?><!-- c --><rss/>")
    touch(tmp_path / ".hidden.glb")
    with pytest.raises(CommandError, match=r"no scenes to render; accepted: \.json"):
        names(tmp_path)


def test_broken_documents_are_kept_so_that_they_are_reported(tmp_path: Path) -> None:
    touch(tmp_path / "broken.json", '{"shapes": [')
    touch(tmp_path / "empty.xml")
    touch(tmp_path / "empty.glb")
    assert names(tmp_path) == ["broken", "empty.glb", "empty.xml"]


def test_the_output_folder_is_not_searched(tmp_path: Path) -> None:
    touch(tmp_path / "a.glb")
    touch(tmp_path / "out/b.glb")
    assert names(tmp_path, tmp_path / "out") == ["a"]


def test_same_stems_get_names_of_their_own(tmp_path: Path) -> None:
    touch(tmp_path / "a.glb")
    touch(tmp_path / "a.obj")
    assert names(tmp_path) == ["a.glb", "a.obj"]


def test_a_manifest_of_lines(tmp_path: Path) -> None:
    scene = touch(tmp_path / "scenes/a.glb")
    lines = [
        "# comment",
        "scenes/a.glb",
        "",
        json.dumps({"scene": "scenes/a.glb", "output": "x/b.exr", "settings": {"spp": 2}}),
        "missing.glb",
    ]
    manifest = touch(tmp_path / "jobs.jsonl", "\n".join(lines))
    items = read_inputs(manifest, OUT, {"spp": 8, "seed": 3})
    assert [(i.name, i.settings) for i in items] == [
        ("a", {"spp": 8, "seed": 3}),
        ("x/b", {"spp": 2, "seed": 3}),
        ("missing", {"spp": 8, "seed": 3}),
    ]
    assert items[0].file == scene


def test_a_manifest_as_a_json_list(tmp_path: Path) -> None:
    manifest = touch(tmp_path / "jobs.json", json.dumps(["a.glb", {"scene": "b.glb"}]))
    assert names(manifest) == ["a", "b"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"scene": ', "line 1: not valid JSON"),
        ("[1, ", "not valid JSON"),
        ('{"output": "x"}', 'line 1: accepted: a path, or an object with "scene"'),
        ('{"scene": "a.glb", "spp": 3}', "unknown field .found spp.; accepted: scene, output"),
        ('{"scene": "a.glb", "settings": 3}', "line 1: settings: not an object"),
        ('{"scene": "a.glb", "settings": {"spp": 0}}', r"line 1: spp: .*\(found 0\)"),
        ('{"scene": "a.glb", "output": "../a"}', "leads out of the output folder"),
        ('{"scene": "a.glb", "output": "/a"}', "leads out of the output folder"),
        ('{"scene": "a.glb", "output": ""}', "output: not a name"),
        ("a.glb\nb/a.glb", "line 2: the same output as .*line 1"),
        ("", "no scenes to render"),
    ],
)
def test_a_bad_manifest_is_refused_before_anything_is_rendered(
    tmp_path: Path, text: str, message: str
) -> None:
    manifest = touch(tmp_path / "jobs.jsonl", text)
    with pytest.raises(CommandError, match=message) as caught:
        names(manifest)
    assert caught.value.exit_code == 2


def test_a_binary_file_is_no_manifest(tmp_path: Path) -> None:
    manifest = tmp_path / "jobs.bin"
    manifest.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(CommandError, match="not a readable manifest"):
        names(manifest)


def test_a_missing_input_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CommandError, match="no such file or folder"):
        names(tmp_path / "nothing")
