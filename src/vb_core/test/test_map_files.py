"""Maps in map_server's format, and files that are written completely or not at all."""

import cv2
import numpy as np
import pytest

from refusals import refused
from vb_core.errors import CodedError
from vb_core.files import write_atomically, write_together
from vb_core.grid_map import GridMap
from vb_core.map_files import read_map, safe_path, write_map

DESCRIPTION = "image: map.pgm\nresolution: 0.1\norigin: [1.0, 2.0, 0.0]\n"
DESCRIPTION += "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"


@pytest.mark.parametrize("raw", [False, True])
def test_map_files_round_trip(tmp_path, raw):
    random = np.random.default_rng(1)
    values = np.arange(-1, 101) if raw else np.array([-1, 0, 100])
    grid = GridMap(random.choice(values, (37, 53)).astype(np.int8), 0.025, (-3.5, 2.25, -0.7))
    files = write_map(tmp_path / "lab", grid, raw)
    assert [path.name for path in files] == ["lab.pgm", "lab.yaml"]
    again = read_map(files[1])
    assert np.array_equal(again.data, grid.data)
    assert again.same_geometry(grid)
    assert files[0].read_bytes()[:2] == b"P5"


def test_trinary_files_hold_what_map_saver_would_write(tmp_path):
    grid = GridMap(np.array([[0, 19, 25, 50, 64, 65, 100, -1]], np.int8), 0.05)
    assert read_map(write_map(tmp_path / "m", grid)[1]).data.tolist() == [[0, 0, -1, -1, -1, 100, 100, -1]]


@pytest.mark.parametrize("name", ["../x", "/etc/x", "a/b", "", ".hidden", "a..b", "x\n", "a" * 200, "a\x00b"])
def test_names_cannot_leave_the_folder(tmp_path, name):
    with refused("bad_file_name"):
        safe_path(tmp_path, name)


@pytest.mark.parametrize(
    "extra, expected",
    [
        ("", [[-1, 0, 0], [100, 0, -1]]),
        ("mode: raw\n", [[100, -1, -1], [0, -1, -1]]),
        ("mode: scale\n", [[89, 0, 0], [100, 0, 1]]),
        ("negate: true\n", [[-1, 100, 100], [0, 100, 100]]),
    ],
)
def test_each_mode_is_read_as_map_server_reads_it(tmp_path, extra, expected):
    image = np.array([[0, 254, 205], [100, 254, 254]], np.uint8)
    (tmp_path / "map.pgm").write_bytes(b"P5\n3 2\n255\n" + image.tobytes())
    (tmp_path / "map.yaml").write_text(DESCRIPTION.replace("negate: 0\n", "") + extra)
    grid = read_map(tmp_path / "map.yaml")
    assert grid.data.tolist() == expected
    assert grid.origin == (1.0, 2.0, 0.0)


def test_transparent_pixels_are_unknown_in_scale_mode(tmp_path):
    image = np.array([[[150, 150, 150, 255], [150, 150, 150, 0]]], np.uint8)
    cv2.imwrite(str(tmp_path / "map.png"), image)
    (tmp_path / "map.yaml").write_text(DESCRIPTION.replace(".pgm", ".png") + "mode: scale\n")
    assert read_map(tmp_path / "map.yaml").data.tolist() == [[47, -1]]


@pytest.mark.parametrize(
    "old, new, key",
    [
        ("image: map.pgm\n", "", "image"),
        ("image: map.pgm", "image: none.pgm", "none.pgm"),
        ("image: map.pgm", "image: map.yaml", "damaged"),
        ("resolution: 0.1\n", "", "resolution"),
        ("resolution: 0.1", "resolution: x", "resolution"),
        ("resolution: 0.1", "resolution: -1", "resolution"),
        ("[1.0, 2.0, 0.0]", "[0]", "origin"),
        ("[1.0, 2.0, 0.0]", "[0, 0, .nan]", "origin"),
        ("free_thresh: 0.196", "free_thresh: low", "free_thresh"),
        ("negate: 0", "negate: 'no'", "negate"),
        ("resolution: 0.1", "mode: odd", "mode"),
        (DESCRIPTION, "", "contains no"),
        (DESCRIPTION, "[", "YAML"),
    ],
)
def test_a_refused_map_file_names_its_key(tmp_path, old, new, key):
    (tmp_path / "map.pgm").write_bytes(b"P5\n1 1\n255\n\xfe")
    (tmp_path / "map.yaml").write_text(DESCRIPTION.replace(old, new))
    with pytest.raises(CodedError, match=key) as caught:
        read_map(tmp_path / "map.yaml")
    assert caught.value.code == "bad_map_file"


def test_files_are_written_together_or_none_is(tmp_path):
    first, second = tmp_path / "a", tmp_path / "folder/b"
    write_together({first: b"1", second: b"2"})
    assert [path.read_bytes() for path in (first, second)] == [b"1", b"2"]
    (tmp_path / "file").write_text("")
    for beyond in (tmp_path / "file" / "c", tmp_path / "folder"):  # where no file can be created or replaced
        with refused("cannot_write"):
            write_together({beyond: b"4", first: b"3"})
    assert first.read_bytes() == b"1"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "file", "folder"]


def test_only_its_owner_can_read_a_private_file(tmp_path):
    for private, mode in ((True, 0o600), (False, 0o644)):
        write_atomically(tmp_path / "a", b"1", private)
        assert (tmp_path / "a").stat().st_mode & 0o777 == mode
