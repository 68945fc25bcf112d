"""No stop is released by an earlier command or lost, whatever process is killed and whatever disk is full."""

import random
from pathlib import Path

import pytest

from vb_testing import assert_fields
from vb_core import stop_latch
from vb_core.errors import CodedError
from vb_core.stop_latch import HeldStops, StopLatch, new_id

SEQUENCES = 10_000
WITHOUT_NUMBER = '{"number": "", "stops": [], "stopped": false, "by": ""}'


def test_a_resume_releases_only_the_stop_that_its_sender_saw():
    latch = StopLatch()
    assert latch.number
    assert latch.resume("anything")
    latch.stop("a", "page")
    first = latch.number
    latch.stop("b", "voice")
    assert [latch.resume(first), latch.resume("b")] == [False, False]
    assert_fields(latch, stopped=True, stopped_by="page")
    assert latch.resume(latch.number)
    assert not latch.stopped


def test_a_press_that_comes_twice_is_one_stop():
    latch = StopLatch()
    assert [latch.stop("a", "page"), latch.stop("a", "page")] == [True, False]
    assert latch.resume(latch.number)
    assert not latch.stop("a", "page")
    assert not latch.stopped


@pytest.mark.parametrize("content", ["", "{", "[]", WITHOUT_NUMBER, '{"stopped": false}'])
def test_a_damaged_file_counts_as_stopped(tmp_path, content):
    path = tmp_path / "stop"
    path.write_text(content)
    latch = StopLatch(path)
    assert_fields(latch, stopped=True, lost=True)
    assert latch.stopped_by
    again = StopLatch(path)
    assert_fields(again, stopped=True, number=latch.number)
    assert latch.resume(latch.number)
    assert not latch.lost


@pytest.mark.parametrize("content", ["", "{", "{}", "[1]", '[""]'])
def test_a_robot_with_a_damaged_file_counts_as_stopped(tmp_path, content):
    path = tmp_path / "stops"
    path.write_text(content)
    assert HeldStops(path).stopped


def test_a_latch_that_cannot_store_counts_as_stopped(tmp_path):
    (tmp_path / "file").write_text("")
    latch = StopLatch(tmp_path / "file" / "stop")  # its folder is missing and cannot be created
    assert_fields(latch, stopped=True, lost=True, stored=False)
    assert latch.resume(latch.number)
    assert not latch.stopped
    assert not latch.store()


def test_a_stop_survives_a_full_disk(tmp_path, monkeypatch):
    path = tmp_path / "stop"
    latch = StopLatch(path)
    assert latch.store()
    monkeypatch.setattr(stop_latch, "write_atomically", full_disk)
    latch.stop("a", "page")
    assert not latch.store()
    assert not latch.stored
    monkeypatch.undo()
    assert StopLatch(path).stopped
    assert latch.store()
    assert StopLatch(path).stops[-1] == "a"


def test_a_robot_reports_a_stop_once_it_outlives_the_driver(tmp_path, monkeypatch):
    held_stops = HeldStops(tmp_path / "stops")
    held_stops.add("a")
    assert_fields(held_stops, stopped=True, persisted_ids=())
    assert held_stops.store()
    assert held_stops.persisted_ids == HeldStops(tmp_path / "stops").ids == ("a",)
    monkeypatch.setattr(stop_latch, "write_atomically", full_disk)  # a notice says that these may be lost
    held_stops.add("b")
    assert not held_stops.store()
    assert held_stops.persisted_ids == ("a", "b")


def full_disk(path, _content):
    raise CodedError("cannot_write", what=str(path), reason="no space left")


class Lab:
    """One manager, two robots and five people. Messages arrive late and in any order.

    The oracle is what people did: when each stop was pressed, and when each obeyed resume was given.
    """

    def __init__(self, random, full):
        self.random, self.time, self.full = random, 0.0, full
        self.queue = []  # (time of arrival, action)
        self.pressed = {}  # by id: its time
        self.promised = set()  # ids answered as stored
        self.resumes = []  # obeyed: (time given, stops known)
        self.manager = StopLatch(Path("manager"))
        self.robots = [HeldStops(Path(f"robot {number}")) for number in range(2)]
        self.known = set()  # every stop that the manager ever knew of
        self.heard = [set(), set()]  # by robot: stops that it has heard and stored
        self.seen = [""] * 5  # by person: the newest stop that they saw

    def later(self, action):
        self.queue.append((self.time + self.random.choice([0.0, 0.05, 0.3, self.random.uniform(0.0, 8.0)]), action))

    def press_stop(self):
        identity = new_id()
        self.pressed[identity] = self.time
        for robot in range(2):
            if self.random.random() < 0.7:  # a message may reach nobody
                self.later(lambda robot=robot: self.add(robot, identity))
        self.later(lambda: self.handle_stop(identity))

    def press_resume(self, person):
        if self.random.random() < 0.7:
            self.look(person)
        seen_stop, pressed_at = self.seen[person], self.time
        self.later(lambda: self.handle_resume(seen_stop, pressed_at))

    def look(self, person):
        self.seen[person] = self.manager.number if self.manager is not None else self.seen[person]

    def add(self, robot, identity):
        if self.robots[robot] is None:
            return
        self.robots[robot].add(identity)
        if self.random.random() < 0.05:
            self.kill_robot(robot)  # before the stop is stored
            return
        self.robots[robot].store()
        self.heard[robot].add(identity)
        self.count_own(robot)

    def count_own(self, robot):
        """Registers a robot's own stops, each of which stands for all those that it had heard."""
        own_stops = [identity for identity in self.robots[robot].ids if identity not in self.pressed]
        self.pressed.update(dict.fromkeys(own_stops, self.time))
        self.heard[robot] = set(self.robots[robot].ids) if own_stops else self.heard[robot]

    def handle_stop(self, identity):
        if self.manager is None:
            return
        self.manager.stop(identity, "person")
        self.known.add(identity)
        if self.random.random() < 0.05:
            self.kill_manager()  # before the stop is stored and answered
            return
        self.manager.store()
        self.promised.add(identity)
        assert self.manager.stopped or self.released(identity)

    def handle_resume(self, seen_stop, pressed_at):
        if self.manager is None:
            return
        known_stops, was_stopped = self.manager.stops, self.manager.stopped
        if self.manager.resume(seen_stop) and was_stopped:
            later_stops = [identity for identity in known_stops if self.pressed.get(identity, -1.0) >= pressed_at]
            assert not later_stops, "it released a stop that came after it"
            self.resumes.append((pressed_at, set(self.known)))
        if self.random.random() >= 0.05:
            self.manager.store()
        else:
            self.kill_manager()

    def tell_robots(self):
        if self.manager is not None:
            stopped, _by, _number, stops = self.manager.snapshot()
            for robot in range(2):
                self.later(lambda robot=robot: self.follow(robot, stopped, stops))

    def follow(self, robot, stopped, stops):
        if self.robots[robot] is not None:
            self.robots[robot].update_from_latch(stopped, stops)
            self.robots[robot].store()
            self.count_own(robot)

    def tell_manager(self):
        for robot in filter(None, self.robots):
            for identity in robot.ids:
                self.later(lambda identity=identity: self.hear_of(identity))

    def hear_of(self, identity):
        if self.manager is not None:
            self.manager.stop(identity, "robot")
            self.known.add(identity)

    def kill_manager(self):
        self.manager = None

    def kill_robot(self, robot):
        self.robots[robot] = None

    def start(self):
        """Restarts every dead process."""
        # a process that lost its file holds one stop of its own in place of all that it knew
        if self.manager is None:
            self.manager = StopLatch(Path("manager"))
            if self.manager.lost:
                own_stop = self.manager.stops[-1]
                self.pressed[own_stop] = self.time
                self.promised = {own_stop}
                self.known.add(own_stop)
        for robot in range(2):
            if self.robots[robot] is None:
                self.robots[robot] = HeldStops(Path(f"robot {robot}"))
                self.count_own(robot)

    def released(self, identity):
        """Returns whether a resume was given after a stop, while the manager knew of that stop."""
        pressed_at = self.pressed[identity]
        return any(resumed_at > pressed_at and identity in known_stops for resumed_at, known_stops in self.resumes)

    def check(self):
        for robot, heard in zip(self.robots, self.heard):
            if robot is not None and not robot.stopped:
                lost = [identity for identity in heard if not self.released(identity)]
                assert not lost, "a robot drives although it has heard of a stop that nobody released"
        if self.manager is not None and not self.manager.stopped:
            lost = [identity for identity in self.promised if not self.released(identity)]
            assert not lost, "a stop that was answered is lost"

    def step(self):
        self.time += self.random.expovariate(3.0)
        for entry in sorted(self.queue, key=lambda entry: entry[0]):
            if entry[0] <= self.time:
                self.queue.remove(entry)
                entry[1]()
                self.check()
        person = self.random.randrange(5)
        actions = [
            (0.22, self.press_stop),
            (0.22, lambda: self.press_resume(person)),
            (0.2, lambda: self.look(person)),
            (0.14, self.tell_robots),
            (0.08, self.tell_manager),
            (0.03, self.kill_manager),
            (0.03, lambda: self.kill_robot(person % 2)),
            (0.05, self.start),
            (0.03, lambda: self.full.update(self.random.sample(["manager", "robot 0", "robot 1"], 1))),
        ]
        weights, choices = zip(*actions)
        self.random.choices(choices, weights)[0]()
        if self.random.random() < 0.05:
            self.full.clear()
        self.check()

    def end_well(self):
        """Restarts everything; then one person looks and says resume until the robots may drive."""
        self.full.clear()
        self.queue.clear()
        for _ in range(4):
            self.start()
            self.tell_manager()
            self.time += 10.0
            self.tell_robots()
            self.time += 10.0
            for _at, action in [self.queue.pop(0) for _ in list(self.queue)]:
                action()
                self.check()
            self.look(0)
            self.handle_resume(self.seen[0], self.time)
        for robot in range(2):
            self.start()
            self.follow(robot, *self.manager.snapshot()[::3])


@pytest.mark.parametrize("part", range(10))
def test_no_stop_is_lost_or_released_by_an_older_command(part, monkeypatch):
    files = {}
    full = set()

    def write(path, content):
        if path.name in full:
            full_disk(path, content)
        files[path.name] = content

    def read(path):
        if path.name not in files:
            raise FileNotFoundError(path)
        return files[path.name]

    monkeypatch.setattr(stop_latch, "write_atomically", write)
    monkeypatch.setattr(Path, "read_bytes", read)
    monkeypatch.setattr(stop_latch, "_empty", lambda path: files.update({path.name: b""} if path.name in files else {}))
    released = stopped = 0
    for seed in range(part * SEQUENCES // 10, (part + 1) * SEQUENCES // 10):
        files.clear()
        full.clear()
        lab = Lab(random.Random(seed), full)
        for _ in range(60):
            lab.step()
        released += len(lab.resumes)
        stopped += len(lab.pressed)
        lab.end_well()
        assert lab.manager is None or not any(robot.stopped for robot in lab.robots), seed
    # the sequences contain what they test
    assert released > SEQUENCES // 20
    assert stopped > SEQUENCES // 5
