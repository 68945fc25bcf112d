"""Spots rendered at known positions, and everything that is not a spot."""

from itertools import product
from unittest.mock import Mock

import cv2
import numpy as np
import pytest

from spot_scenes import GREEN, RED, ImageDetector, Scene, from_above, shown, tinted
from refusals import refused
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_laser_detect.detection.features import SpotClassifier
from vb_laser_detect.detection.spot_detector import DetectorParams

PERIOD = 0.04
KINDS = product((1.2, 2.5, 5.0), (RED, GREEN), ("bgr", "bayer"))  # size and colour of a spot, kind of camera


def at_once(preset=DetectorParams, **kind):
    return ImageDetector(preset(confirm_frames=1), **kind)


def feed(detector, images, start=0.0):
    """Returns the spots of each image, at 25 images a second."""
    return [detector.detect(image, start + PERIOD * i) for i, image in enumerate(images)]


def settled(scene, detector, kind="bgr"):
    """Shows the detector the empty floor for a third of a second, and returns both."""
    feed(detector, [shown(scene, "bayer" if detector.bayer else kind) for _ in range(8)])
    return scene, detector


def steps_seen(detector, images, place=None, start=0.4):
    """Returns the numbers of those (number, image) for which a spot is reported, at once or later; each where it was drawn."""
    steps = set()
    for number, image in images:
        spots = detector.detect(image, start + PERIOD * number)
        reported = [(round((spot.stamp - start) / PERIOD), (spot.u, spot.v)) for spot in spots + detector.earlier]
        assert all(np.linalg.norm(np.subtract((place or drawn)(step), pixel)) < 3.0 for step, pixel in reported)
        steps |= {step for step, _ in reported}
    return steps


def follow(detector, scene, truths, start=0.4, change=lambda i: {}, kind="", **spot):
    """Returns for each image the errors [px] of its spots; `change` gives further arguments of its rendering."""
    errors = []
    kind = kind or ("bayer" if detector.bayer else "bgr")
    for i, (u, v) in enumerate(truths):
        image = shown(scene, kind, [(u, v)], **spot, **change(i))
        errors.append([np.hypot(hit.u - u, hit.v - v) for hit in detector.detect(image, start + PERIOD * i)])
    return errors


@pytest.mark.parametrize(
    "room, spot, kind",
    [
        *(({}, {"sigma": sigma, "color": color}, kind) for sigma, color, kind in KINDS),
        *(({"brightness": brightness}, {}, "bgr") for brightness in (20.0, 60.0, 180.0)),
        ({}, {"color": GREEN}, "mono"),  # a monochrome camera need not show colour
        # hardly larger than a pixel, but not faint
        ({"brightness": 60.0, "noise": 2.0}, {"sigma": 0.75, "power": 190.0, "color": GREEN}, "bgr"),
        # 500 px/s are 1 m/s at 2 mm per pixel; the shutter is open for 20 ms
        ({}, {"smear": (10.0, 0.0)}, "bgr"),
    ],
)
def test_spot_is_found_to_a_fraction_of_a_pixel(room, spot, kind):
    scene, detector = settled(Scene(**room), at_once(bayer=kind == "bayer"), kind)
    truths = np.random.default_rng(2).uniform((40, 40), (600, 320), (25, 2))
    found = follow(detector, scene, truths, kind=kind, **spot)
    errors = sum(found, [])
    assert max(map(len, found)) == 1 and len(errors) >= 24
    limit = 0.3 if room else 0.2
    assert np.median(errors) < limit and max(errors) < 5 * limit


def test_spot_held_still_for_ten_seconds_stays():
    scene, detector = settled(Scene(320, 192), at_once())
    images = [scene.render([(150.3, 90.7)]) for _ in range(5)]
    found = feed(detector, images * 50, 0.4)
    assert all(len(spots) == 1 for spots in found)
    assert feed(detector, [scene.render() for _ in range(5)], 11.0) == [[]] * 5


# ------------------------------------------------------------------ no spots
def with_box(scene, left, top, wide, high, value=0.0, gain=0.0, floor=None):
    """Returns the floor with a part in another colour, or `gain` times as bright."""
    floor = (scene.floor if floor is None else floor).copy()
    part = floor[top : top + high, left : left + wide]
    part[:] = gain * part + value
    return floor


def person(scene, i):
    trousers = with_box(scene, 6 * i, 120, 60, 100, (60, 50, 45))
    return with_box(scene, 6 * i + 15, 150, 30, 40, (90, 120, 170), floor=trousers)


def taken_away(scene, i):
    """Returns a floor with a small dark object, and an arm that takes it away to the right."""
    floor = with_box(scene, 300, 150, 12, 12, 15) if i < 26 else scene.floor
    reach = max(0, 330 - 44 * abs(i - 26))
    return with_box(scene, 640 - reach, 140, reach, 30, (90, 120, 170), floor=floor) if reach else floor


DISTURBANCES = {
    "still": lambda scene, i: {},
    "switched light": lambda scene, i: {"gain": 1.0 if i < 20 else 1.5},
    "drifting exposure": lambda scene, i: {"gain": 1.0 + 0.01 * i},
    "moved dark box": lambda scene, i: {"floor": with_box(scene, 100 if i < 25 else 330, 100, 24, 24, 15)},
    "taken away": lambda scene, i: {"floor": taken_away(scene, i)},
    "moved bright sheet": lambda scene, i: {"floor": with_box(scene, 100 if i < 25 else 330, 100, 64, 90, 235)},
    "printed dot from the start": lambda scene, i: {"floor": with_box(scene, 400, 200, 8, 8, 250)},
    "sun patch": lambda scene, i: {"floor": with_box(scene, 200, 60, 220, 4 * i, gain=2.6)},
    "walking person": lambda scene, i: {"floor": person(scene, i)},
}


@pytest.mark.parametrize("bayer", [False, True])
@pytest.mark.parametrize("disturbance", DISTURBANCES.values(), ids=DISTURBANCES)
def test_no_spot_without_a_laser(disturbance, bayer):
    scene = Scene()
    images = [scene.render(bayer=bayer, **disturbance(scene, i)) for i in range(60)]
    assert feed(at_once(bayer=bayer), images) == [[]] * 60


@pytest.mark.parametrize("white", [140.0, 235.0])
def test_a_spot_is_found_by_cameras_whose_white_is_below_255(white):
    # limited-range video ends at 235; a spot reaches the camera's white, a grey object does not
    scene, detector = Scene(), at_once()

    def shade(image):
        return np.round(image * (white / 255.0)).astype(np.uint8)

    floor = scene.floor.copy()
    floor[300:340, 20:100] = 255
    feed(detector, [shade(scene.render(floor=floor)) for _ in range(8)])
    found = feed(detector, [shade(scene.render([(100 + 15.3 * i, 150)], floor=floor)) for i in range(20)], 0.4)
    assert sum(len(spots) for spots in found) >= 19
    floor[200:208, 400:408] = 150
    assert feed(detector, [shade(scene.render(floor=floor)) for _ in range(5)], 1.3) == [[]] * 5


@pytest.mark.parametrize("laser", [RED, GREEN])
def test_bayer_images_distinguish_white_light_from_a_laser(laser):
    scene, detector = settled(tinted(Scene()), at_once(bayer=True))
    white = {"spots": [(300, 150)], "color": (1.0, 1.0, 1.0), "bayer": True}
    assert feed(detector, [scene.render(**white) for _ in range(10)], 0.4) == [[]] * 10
    assert "chroma_mosaic" in {candidate.rejection for candidate in detector.detections[-1].candidates}
    other = tinted(Scene())
    beside = [other.render([(80 + 10.0 * i, 300)], color=laser, bayer=True) for i in range(20)]
    found = feed(detector, [np.maximum(scene.render(**white), image) for image in beside], 0.8)
    assert sum(len(spots) == 1 and abs(spots[0].v - 300) < 1.0 for spots in found) >= 19


def test_small_glints_that_move_are_no_spots_on_bayer_images():
    # the Bayer pattern gives a glint hardly larger than a pixel a colour that changes as it moves
    scene, detector = settled(tinted(Scene()), ImageDetector(bayer=True))
    looked_at, found, time = 0, 0, 0.4
    for sigma in (0.5, 0.6, 0.7):
        for u, v in ((7.3, 3.1), (9.4, 0.6), (5.7, 8.2), (8.3, 4.7)):
            places = [(100.2 + u * i, 100.3 + v * i) for i in range(12)]
            glints = [scene.render([place], sigma, 700.0, (1.0, 1.0, 1.0), bayer=True) for place in places]
            found += sum(map(len, feed(detector, glints, time)))
            looked_at += sum(c.rejection != "too_dark" for each in detector.detections[-12:] for c in each.candidates)
            feed(detector, [scene.render(bayer=True) for _ in range(8)], time + 12 * PERIOD)
            time += 20 * PERIOD
    assert looked_at > 100 and found == 0


@pytest.mark.parametrize("bayer", [False, True])
@pytest.mark.parametrize("brightness, gain", [(60.0, 1.6), (60.0, 2.5), (110.0, 1.6)])
def test_a_spot_is_followed_into_light_that_comes(brightness, gain, bayer):
    scene, detector = settled(tinted(Scene(brightness=brightness)), ImageDetector(bayer=bayer))

    def beam(i):
        """Draws the spot beside the beam; then the beam's edge moves along under it, a larger region than any spot."""
        come = 3 * max(0, i - 15)
        return {"floor": with_box(scene, 300 - come, 120, 120 + come, 120, gain=gain)}

    offsets = sum(follow(detector, scene, [(150.0 + 3.0 * i, 180.0) for i in range(60)], change=beam), [])
    assert len(offsets) >= 55 and max(offsets) < 1.5


def test_what_comes_beside_a_followed_spot_is_no_reason_to_lose_it():
    scene, detector = settled(tinted(Scene()), ImageDetector(bayer=True))

    def leg(i):
        """A dark leg moves along beside the spot for a third of a second."""
        return {"floor": with_box(scene, 155 + 3 * i, 100, 55, 230, gain=0.2)} if 20 <= i < 28 else {}

    found = follow(detector, scene, [(150.0 + 3.0 * i, 180.0) for i in range(40)], change=leg)
    assert all(len(spots) == 1 for spots in found[3:])


@pytest.mark.parametrize("gain, bayer", [(1.4, False), (0.4, False), (0.4, True)])
def test_a_spot_is_followed_over_a_switched_light(gain, bayer):
    scene, detector = settled(Scene(), at_once(bayer=bayer))
    lights = [1.0] * 5 + [gain] * 60
    held = follow(detector, scene, [(300, 150)] * 65, change=lambda i: {"gain": lights[i], "power": 420.0 / lights[i]})
    # held still throughout: not even in the image with the new light is it taken for floor
    assert sum(len(spots) for spots in held) >= 64
    assert feed(detector, [scene.render(gain=gain, bayer=bayer) for _ in range(10)], 4.0) == [[]] * 10


def test_a_spot_is_examined_although_brighter_regions_compete():
    # on a bright floor each of them brightens more than the spot can
    scene, detector = Scene(brightness=200.0), at_once()
    floor = np.minimum(scene.floor, 215.0)
    floor[:, :280] = 40.0
    feed(detector, [scene.render(floor=floor) for _ in range(8)])
    beside = floor.copy()
    for row in range(6):
        for column in range(5):
            beside[20 + 56 * row : 44 + 56 * row, 20 + 52 * column : 40 + 52 * column] = 215.0
    found = follow(detector, scene, [(400 + 8.0 * i, 200) for i in range(20)], change=lambda i: {"floor": beside})
    assert sum(any(off < 1.5 for off in spots) for spots in found) >= 19


def test_a_doubtful_spot_that_stays_is_learnt():
    class Doubtful(SpotClassifier):
        def classify(self, blob, expected):
            return 0.7, "peak"

    scene, detector = settled(Scene(), at_once(classifier=Doubtful({}, 0.0)))
    found = feed(detector, [scene.render([(150, 90)]) for _ in range(75)], 0.4)
    assert all(found[:30]) and not any(found[45:])


# ------------------------------------------------------------------ confirmation, sizes, places
def test_sizes_count_in_millimetres_where_the_pose_is_known():
    for scale, expected in ((0.002, 1), (0.05, 0)):
        scene, detector = settled(Scene(), at_once(geometry=from_above(scale)))
        assert len(detector.detect(scene.render([(200, 150)]), 0.3)) == expected
    assert detector.detections[-1].candidates[0].rejection == "too_large"


def test_without_a_pose_no_spot_is_accepted_and_the_reason_is_returned():
    geometry = from_above(find_pose=Mock(side_effect=CodedError("no_transform")))
    scene, detector = settled(Scene(), at_once(geometry=geometry))
    assert not detector.detect(scene.render([(200, 150)]), 0.3)
    assert detector.detections[-1].candidates[0].rejection == "off_floor"
    assert detector.detections[-1].pose_error.code == "no_transform"


def test_a_place_can_be_rejected_and_the_reason_is_kept():
    right_half = GridMap(np.zeros((100, 100), np.int8), 0.05, (0.0, -2.5, 0.0))
    scene, detector = settled(Scene(), at_once(geometry=from_above(floor=right_half)))
    spots = detector.detect(scene.render([(100, 100), (500, 200)]), 0.3)
    assert [round(spot.u) for spot in spots] == [500]
    assert "spot_outside_map" in [candidate.rejection for candidate in detector.detections[-1].candidates]


@pytest.mark.parametrize("tint", [(1.0, 1.0, 1.0), (0.6, 0.85, 1.05), (1.1, 0.85, 0.6), (0.6, 1.1, 0.7)])
def test_moving_camera_takes_no_paper_for_light(tint):
    # on a coloured floor, white paper adds most in the channel that the floor lacks
    scene = Scene(640, 480)
    scene.floor *= np.array(tint, np.float32)
    scene.floor[200:212, 300:312] = 250
    scene.floor[300:306, 100:106] = 250
    assert feed(at_once(DetectorParams.mobile), [scene.render() for _ in range(10)]) == [[]] * 10


def test_moving_camera_follows_the_spot_over_a_bright_line():
    # a red line on a red carpet: the spot's outline merges with it, and only the previous frame separates them
    scene = Scene(640, 480)
    scene.floor[:, :] = (56, 48, 120) + scene.render()[:, :, :1] * 0.05
    scene.floor[200:204, 100:500] = (95, 80, 190)
    detector = ImageDetector(DetectorParams.mobile())
    assert not any(feed(detector, [scene.render() for _ in range(3)]))
    found = follow(detector, scene, [(250.0 + 0.5 * i, 150.0 + 2.0 * i) for i in range(50)], 1.0, sigma=1.2)
    assert all(len(spots) == 1 and spots[0] < 1.5 for spots in found[2:])


@pytest.mark.parametrize("color", [RED, GREEN])
def test_moving_camera_sees_the_spot_on_the_edge_of_a_carpet(color):
    # borders are drawn along such edges; the brighter side must not merge with the spot
    scene, detector = Scene(640, 480, brightness=150.0), at_once(DetectorParams.mobile)
    scene.floor[150:] *= 0.3
    truths = [(100.0 + 20 * i, 150.0) for i in range(20)]
    offsets = sum(follow(detector, scene, truths, 0.0, sigma=3.0, color=color), [])
    assert len(offsets) <= 20 and sum(off < 2.0 for off in offsets) >= 19


@pytest.mark.parametrize("color", [RED, GREEN])
def test_moving_camera_sees_the_spot_within_the_reflection_of_a_lamp(color):
    scene = Scene(640, 480, brightness=120.0)
    detector = at_once(DetectorParams.mobile, geometry=from_above(0.003))
    lamp = cv2.ellipse(np.zeros((480, 640), np.float32), (320, 300), (34, 20), 0, 0, 360, 90.0, -1)
    scene.floor = scene.floor + cv2.GaussianBlur(lamp, (0, 0), 6)[:, :, None]
    assert not any(feed(detector, [scene.render([])] * 3))
    offsets = sum(follow(detector, scene, [(285.0 + 2 * i, 300.0) for i in range(36)], sigma=3.0, color=color), [])
    # the spot may be missed at the rim, where lamp and floor meet under it, but the lamp is never reported
    assert len(offsets) > 18 and max(offsets) < 8.0


# ------------------------------------------------------------------ lamps, and images out of order
def drawn(step):
    """Returns the position of a pointer that draws to and fro at 150 px/s."""
    return 60.0 + abs((6.0 * step) % 480 - 240), 60.0


@pytest.mark.parametrize("kind", ["bgr", "bayer", "mono"])
@pytest.mark.parametrize("rhythm", [5.0, 3.0, 0.0], ids=["5 Hz", "3 Hz", "steady"])
def test_a_light_that_stays_is_no_pointer_whatever_its_rhythm(rhythm, kind):
    detector = ImageDetector(DetectorParams(max_dwell_time=10.0), bayer=kind == "bayer")
    scene, _ = settled(tinted(Scene(320, 192)), detector, kind)

    def image(step, *spots):
        on = not rhythm or (step * PERIOD * rhythm) % 1.0 < 0.5
        # small: in so small an image a wider spot would be doubtful, and become background sooner. It sways: a grey image's
        # light that lies still is never taken for a spot
        light = 250.0 + np.sin(0.3 * step), 150.0
        return shown(scene, kind, [*spots, *[light] * on], 2.0, color=GREEN if kind == "mono" else RED)

    def distances(steps, draws):
        """Returns, for each image, the distances [px] of its spots from the line that the pointer draws."""
        images = ((step, image(step, drawn(step)) if draws else image(step)) for step in steps)
        return [[abs(spot.v - 60.0) for spot in detector.detect(each, 0.4 + PERIOD * step)] for step, each in images]

    assert any(distances(range(100), draws=False))
    # the light does not delay a pointer that draws
    assert sum(min(spots, default=9.0) < 2.0 for spots in distances(range(100, 200), draws=True)) >= 75
    distances(range(200, 340), draws=False)
    assert not any(distances(range(340, 380), draws=False))
    assert any(detection.lamp_count for detection in detector.detections)
    found = distances(range(380, 460), draws=True)
    assert sum(min(spots, default=9.0) < 2.0 for spots in found) >= 60
    assert max(sum(found, [])) <= 2.0


@pytest.mark.parametrize("every", [10, 12])
def test_images_that_come_late_are_left_out_and_counted(every):
    scene, detector = settled(tinted(Scene(320, 192)), ImageDetector())
    order = list(range(120))
    for i in range(0, 119, every):
        order[i], order[i + 1] = order[i + 1], order[i]
    found = steps_seen(detector, ((step, scene.render([drawn(step)])) for step in order))
    assert sum(detection.is_late for detection in detector.detections) == len(range(0, 119, every)) >= 119 - len(found)


def test_a_pointer_that_blinks_is_seen_in_grey_images_too():
    scene, detector = settled(Scene(320, 192), ImageDetector(), "mono")
    lit = {step for step in range(150) if (step * PERIOD * 2.0) % 1.0 < 0.5}
    white = {"color": (1.0, 1.0, 1.0)}
    images = ((i, shown(scene, "mono", [drawn(i / 3.0)] * (i in lit), **white)) for i in range(150))
    found = steps_seen(detector, images, lambda i: drawn(i / 3.0))
    assert found <= lit and len(found) >= 0.9 * len(lit)


def test_a_weak_pointer_beside_a_lamp_in_grey_images():
    # the brightness of the room counts, not that of the lamp in it
    scene = Scene(brightness=60.0)
    scene.floor[60:80, 560:590] = 255.0
    _, detector = settled(scene, ImageDetector(), "mono")
    white = {"power": 0.3 * 255.0, "color": (1.0, 1.0, 1.0)}
    assert len(steps_seen(detector, ((i, shown(scene, "mono", [drawn(i)], **white)) for i in range(60)))) >= 57


@pytest.mark.parametrize("depth", [0.3, 0.5])
@pytest.mark.parametrize("kind", ["bgr", "mono"])
def test_lamps_that_flicker_over_a_rolling_shutter(depth, kind):
    scene = tinted(Scene(320, 240))
    rows = np.arange(240, dtype=np.float32)[:, None, None]

    def image(step):
        lit = scene.floor * (1.0 + depth * np.sin(2 * np.pi * (rows / 150.0 + 0.13 * step)))
        return shown(scene, kind, [drawn(step)] * (step >= 0), color=GREEN, floor=lit)

    assert len(steps_seen(ImageDetector(), ((step, image(step)) for step in range(-25, 100)), start=1.0)) >= 90


def test_images_that_come_in_bursts():
    scene, detector = settled(tinted(Scene(480, 192)), ImageDetector(geometry=from_above(0.004)))
    found = 0
    for step in range(90):
        # three at a time, stamped on arrival; the spot moves at 2 m/s
        u = 60.0 + abs((20.0 * step) % 720 - 360)
        detector.detect(scene.render([(u, 60.0)]), 0.4 + 3 * PERIOD * (step // 3) + 0.001 * (step % 3))
        found += any(abs(spot.u - u) < 3.0 and not spot.rejection for spot in detector.detections[-1].candidates[-1:])
    assert found >= 80


# ------------------------------------------------------------------ rates
@pytest.mark.parametrize("rate", [2.0, 3.0, 60.0])
@pytest.mark.parametrize("preset", [DetectorParams, DetectorParams.mobile])
def test_slow_and_fast_cameras_yield_spots(rate, preset):
    scene, detector = Scene(320, 192), ImageDetector(preset())
    found = []
    for i in range(16):
        spots = detector.detect(scene.render([(60.0 + 12.0 * i, 100.0)] * (i >= 4)), 10.0 + i / rate)
        found += spots + detector.earlier
    assert len(found) == 12
    assert all(abs(spot.v - 100.0) < 3.0 for spot in found)


# ------------------------------------------------------------------ bad input
@pytest.mark.parametrize(
    "shape, kind", [((0, 0), "u1"), ((8, 8), "u1"), ((64, 64), "u2"), ((64, 64, 2), "u1"), (64, "u1")]
)
def test_bad_images_are_refused(shape, kind):
    with refused("bad_image"):
        at_once().detect(np.zeros(shape, kind), 0.0)


def test_time_that_jumps_back_and_images_that_change_size():
    detector, small, large = at_once(), Scene(320, 192), Scene(331, 245)
    for scene, start in ((small, 100.0), (small, 5.0), (large, 6.0)):
        feed(detector, [scene.render() for _ in range(5)], start)
        assert len(detector.detect(scene.render([(100, 100)]), start + 0.5)) == 1


@pytest.mark.parametrize("bayer", [False, True])
@pytest.mark.parametrize("preset", [DetectorParams, DetectorParams.mobile])
@pytest.mark.parametrize("color", [(225, 80, 50), (30, 130, 250), (60, 230, 40), (45, 35, 235)])
@pytest.mark.parametrize("radius", [3, 5, 9])
def test_paint_takes_light_from_some_channel_and_is_no_spot(preset, bayer, color, radius):
    # paper dots that are laid down are as sudden, round and bright as a spot, and more coloured
    scene, detector = tinted(Scene(320, 240)), at_once(preset, bayer=bayer)
    feed(detector, [scene.render(bayer=bayer) for _ in range(5)])
    dot = cv2.circle(np.zeros((240, 320), np.float32), (150, 120), radius, 1.0, -1, cv2.LINE_AA)
    dot = cv2.GaussianBlur(dot, (0, 0), 0.8)[:, :, None]
    laid = scene.floor * (1.0 - dot) + dot * np.array(color, np.float32)
    assert feed(detector, [scene.render(floor=laid, bayer=bayer) for _ in range(3)], 0.2) == [[]] * 3
    # light beside the dot is a spot
    assert len(detector.detect(scene.render([(60, 60)], floor=laid, bayer=bayer), 0.32)) == 1
