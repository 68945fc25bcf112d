"""Which sighting belongs to which track, when it is confirmed, and which track is published, at every frame rate."""

from types import SimpleNamespace

import numpy as np
import pytest

from vb_laser_detect.detection.projection import GROUND_PLANE
from vb_laser_detect.detection.spot_tracker import SpotTracker
from vb_laser_detect.detection.stage_results import FloorPoint, Spot

GREEN = np.array([0.1, 1.0, 0.1])


def sighting(x, y=0.0, confidence=0.9, tint=GREEN):
    """Returns a spot at (x, y) [m] below a camera with 2 mm per pixel."""
    place = FloorPoint(np.array([x, y, 0.0]), 0.002, GROUND_PLANE)
    return Spot(500 * x, 500 * y, 8.0, confidence, tint=tint, floor_point=place)


class Film:
    """Feeds a tracker images at a rate [1/s]."""

    def __init__(self, rate=25.0, mosaic=False, confirm_frames=3, may_rest=False):
        self.tracker = SpotTracker(confirm_frames, max_dwell_time=25.0, may_rest=may_rest)
        self.image = SimpleNamespace(diagonal=800.0, picture=SimpleNamespace(is_bayer=mosaic))
        self.period = 1.0 / rate
        self.now = 0.0

    def see(self, *sightings):
        """Shows the tracker an image with these sightings, and returns the state of each one's track."""
        self.now += self.period
        self.tracker.predict(self.now)
        detection, tracks = self.tracker.update(sightings, self.image), []
        earlier = [round(spot.stamp / self.period) - 1 for spot in detection.spots[:-1]]
        for spot in detection.candidates:
            backfilled = [] if spot.rejection else earlier
            states = {"is_published": not spot.rejection, "is_confirmed": spot.rejection != "unconfirmed"}
            tracks.append(SimpleNamespace(number=spot.track, backfilled=backfilled, **states))
        return tracks


@pytest.mark.parametrize("rate", [2.0, 4.0, 8.0, 25.0, 60.0])
def test_a_stroke_is_confirmed_and_keeps_its_number_at_every_rate(rate):
    film = Film(rate)
    tracks = [film.see(sighting(0.4 * i / rate))[0] for i in range(20)]
    assert [track.is_published for track in tracks] == [False, False] + [True] * 18
    assert tracks[2].backfilled == [0, 1] and not any(track.backfilled for track in tracks[3:])
    assert len({track.number for track in tracks}) == 1


@pytest.mark.parametrize("rate", [2.0, 25.0])
def test_a_track_survives_two_missed_images_but_not_more(rate):
    film = Film(rate)
    first = [film.see(sighting(0.0))[0] for _ in range(5)][-1]
    film.see(), film.see()
    assert film.see(sighting(0.01))[0] == first
    for _ in range(30):
        film.see()
    assert not film.see(sighting(0.01))[0].is_published


def test_a_newcomer_takes_nobodys_place():
    film = Film()
    laser = [film.see(sighting(0.01 * i, confidence=0.5))[0] for i in range(5)][-1]
    for i in range(5, 60):
        tracks = film.see(sighting(0.01 * i, 0.5, confidence=0.99), sighting(0.01 * i, confidence=0.5))
        assert [track.is_published for track in tracks] == [False, True] and tracks[1].number == laser.number
    # not even while the laser is hidden; once that is lost, the other one is published without its earlier sightings
    assert not film.see(sighting(0.6, 0.5))[0].is_published
    later = [film.see(sighting(0.6, 0.5))[0] for _ in range(20)]
    assert later[-1].is_published and not any(track.backfilled for track in later)


def test_jumps_that_no_hand_makes_are_other_spots():
    film = Film()
    first = [film.see(sighting(0.0))[0] for _ in range(4)][-1]
    assert film.see(sighting(3.0))[0].number != first.number  # 75 m/s
    assert film.see(sighting(0.1))[0].number == first.number


def test_two_that_cross_keep_their_numbers():
    film = Film()
    for t in np.linspace(0.0, 1.0, 41):
        rising, falling = film.see(sighting(t, t), sighting(t, 1.0 - t + 0.013))
        assert (rising.number, falling.number) == (1, 2)


def test_a_blob_that_several_regions_show_is_one_sighting():
    film = Film()
    assert len(film.see(sighting(0.1), sighting(0.103), sighting(0.105))) == 2  # 1.5 and 2.5 px from the first


def test_what_is_never_confirmed_waits_for_a_second_only():
    film = Film(confirm_frames=50, mosaic=True)
    for _ in range(200):
        film.see(sighting(0.0, tint=None))
    (track,) = film.tracker._tracks
    assert 2 <= len(track.unpublished) <= 60


@pytest.mark.parametrize(
    "sway, options, is_spot",
    [(0.001, {}, True), (0.0002, {}, False), (0.0002, {"may_rest": True}, True), (0.001, {"mosaic": True}, False)],
    ids=["held in a hand", "lying still", "lying still, for calibration", "white in a camera that shows colour"],
)
def test_light_that_shows_no_colour_must_outlast_a_glint_and_move(sway, options, is_spot):
    # a white glint of two pixels has a different colour in each image
    tints = np.array([1.0, 0.5, 1.0, 0.5]), np.array([0.5, 1.0, 0.5, 1.0])
    film = Film(**options)
    confirmed = [film.see(sighting(sway * np.sin(0.4 * i), tint=tints[i % 2]))[0].is_confirmed for i in range(90)]
    assert not any(confirmed[1:14])
    assert confirmed[-1] == is_spot


def test_light_that_shows_colour_need_not_move():
    vivid, pale = Film(), Film(mosaic=True)
    assert [vivid.see(sighting(0.0))[0].is_confirmed for _ in range(4)] == [False, False, True, True]
    assert [pale.see(sighting(0.0, tint=np.array([0.7, 1.0, 0.7])))[0].is_confirmed for _ in range(20)][-1]


def test_a_spot_is_expected_where_its_motion_and_the_camera_s_take_it():
    film = Film()
    for i in range(30):
        film.see(sighting(0.008 * i))
    film.now += film.period
    (expected,) = film.tracker.predict(film.now)
    assert expected.position[0] == pytest.approx(500 * 0.008 * 30)
    assert 8.0 < expected.reach < 30.0
    film.tracker.update([sighting(0.008 * 30)], film.image)
    turn = np.array([[1.0, 0, 40], [0, 1, 0], [0, 0, 1]])  # by 40 px
    (expected,) = film.tracker.predict(film.now + film.period, turn)
    assert expected.position[0] == pytest.approx(500 * 0.008 * 31 + 40.0)
    film.tracker.update([], film.image)
    (expected,) = film.tracker.predict(film.now + 2 * film.period)
    assert expected.position[0] == pytest.approx(500 * 0.008 * 32 + 40.0)
