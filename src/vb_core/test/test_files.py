"""Files that are written whole, or not at all."""

from refusals import refused
from vb_core.files import write_atomically, write_together


def test_files_are_written_together_or_none_is(tmp_path):
    first, second = tmp_path / "a", tmp_path / "folder" / "b"
    write_together({first: b"1", second: b"2"})
    assert (first.read_bytes(), second.read_bytes()) == (b"1", b"2")
    (tmp_path / "file").write_text("")
    for beyond in (tmp_path / "file" / "c", tmp_path / "folder"):  # where no file can be made, or none replaced
        with refused("cannot_write"):
            write_together({beyond: b"4", first: b"3"})
    assert first.read_bytes() == b"1"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "file", "folder"]


def test_only_its_owner_can_read_a_private_file(tmp_path):
    for private, mode in ((True, 0o600), (False, 0o644)):
        write_atomically(tmp_path / "a", b"1", private)
        assert (tmp_path / "a").stat().st_mode & 0o777 == mode
