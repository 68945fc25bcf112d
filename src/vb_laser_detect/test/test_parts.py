"""Blocks, background, tracker, statistics; and that none of it needs ROS."""
import math
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from scenes import GREEN, RED, Scene, tinted
from vb_laser_detect import colour
from vb_laser_detect.appearance import Candidate
from vb_laser_detect.background import Background, is_mosaic
from vb_laser_detect.blocks import block_maxima, mask_of_blocks, max_channel
from vb_laser_detect.debug_image import draw
from vb_laser_detect.detector import DetectorParams
from vb_laser_detect.followed import FollowedSpot
from vb_laser_detect.projection import ProjectionParams
from vb_laser_detect.regions import regions
from vb_laser_detect.statistics import Statistics
from vb_laser_detect.tracker import SpotTracker

PACKAGE = Path(__file__).resolve().parents[1]


@pytest.mark.parametrize("shape", [(64, 96), (64, 96, 3), (67, 101, 3), (33, 47)])
def test_block_maxima_are_numpys(shape):
    image = np.random.default_rng(1).integers(0, 256, shape, dtype=np.uint8)
    background = np.random.default_rng(2).integers(0, 256, shape, dtype=np.uint8)
    rows, columns = shape[0] // 8, shape[1] // 8

    def blocks(values):
        return values[: rows * 8, : columns * 8].reshape(rows, 8, columns, 8, *shape[2:])

    assert (block_maxima(image) == blocks(image).max(axis=(1, 3))).all()
    rise = np.maximum(image.astype(int) - background, 0)
    assert (block_maxima(image, background) == blocks(rise).max(axis=(1, 3))).all()
    assert (block_maxima(image, background, row_step=2) == blocks(rise)[:, 1::2].max(axis=(1, 3))).all()
    assert (block_maxima(image, background, brightest=True) == max_channel(block_maxima(image, background))).all()
    assert (max_channel(image) == (image if image.ndim == 2 else image.max(axis=2))).all()


def test_mask_covers_its_blocks():
    blocks = np.zeros((4, 5), bool)
    blocks[1, 2] = True
    mask = mask_of_blocks(blocks, 35, 43)
    assert mask.sum() == 64 and mask[8:16, 16:24].all()


def test_background_takes_in_what_stays_and_leaves_out_what_is_a_spot():
    floor = np.full((64, 64), 100, np.uint8)
    changed = floor.copy()
    changed[8:16, 8:16] = 200
    changed[32:40, 32:40] = 200
    background = Background(floor, 1.0, 1.5, 60.0)
    spots = np.zeros((8, 8), bool)
    spots[4, 4] = True
    for _ in range(60):
        maxima = background.rise(changed)
        background.learn(changed, maxima, maxima > 18, spots, 0.04)
    assert (background.image[8:16, 8:16] == 200).all()
    assert (background.image[32:40, 32:40] == 100).all()


def test_background_follows_a_slow_drift():
    background = Background(np.full((64, 64), 100, np.uint8), 0.4, 1.5, 60.0)
    for i in range(200):
        image = np.full((64, 64), 100 + i // 10, np.uint8)
        maxima = background.rise(image)
        background.learn(image, maxima, maxima > 18, np.zeros((8, 8), bool), 0.04)
    assert abs(int(background.image.mean()) - 119) <= 4


@pytest.mark.parametrize("bayer", [False, True])
def test_what_a_spot_covered_is_filled_in(bayer):
    scene = Scene(320, 192)
    truth = scene.render(bayer=bayer).astype(int)
    background = Background(scene.render([(150.3, 91.7)], bayer=bayer), 1.0, 1.5, 25.0)
    assert np.abs(background.image.astype(int) - truth)[88:96, 146:156].max() > 100
    background.erase(150.3, 91.7, 12.0)
    assert np.abs(background.image.astype(int) - truth)[88:96, 146:156].max() < 80
    # at the edge there is less to take a median of
    background.erase(1.0, 190.0, 8.0)
    background.erase(318.0, 2.0, 30.0)


def test_bayer_images_are_told_from_grey_ones():
    scene = Scene()
    assert is_mosaic(tinted(scene).render(bayer=True))
    assert not is_mosaic(scene.render(bayer=True)[::2, ::2].copy())
    assert not is_mosaic(scene.render()[:, :, 1].copy())
    assert not is_mosaic(scene.render())
    assert not is_mosaic(np.full((240, 320), 100, np.uint8))


@pytest.mark.parametrize("bayer", [False, True])
def test_tint_is_the_light_s_wherever_a_window_starts(bayer):
    scene = tinted(Scene(200, 160, noise=0.0))
    floor, place = scene.render(bayer=bayer), (81, 62)
    for light, least, most in ((RED, 0.4, 1.0), (GREEN, 0.4, 1.0), ((1.0, 1.0, 1.0), 0.0, 0.2)):
        lit, tints = scene.render([place], 2.5, 100.0, light, bayer=bayer), []
        for left, top in ((60, 40), (62, 44), (58, 50)):
            window = (slice(top, top + 40), slice(left, left + 40))
            rise = cv2.GaussianBlur(max_channel(cv2.subtract(lit[window], floor[window])), (3, 3), 0)
            blob = (rise > 0.35 * rise.max()).astype(np.uint8)
            tints.append(colour.tint_of(blob, rise.astype(np.float32), lit[window], floor[window]))
        assert np.allclose(tints, tints[0], atol=0.02)
        assert least <= colour.chroma(tints[0]) <= most
    # four places of a pattern, of which green has two; three channels
    assert len(tints[0]) == (4 if bayer else 3)


def test_white_light_in_a_shadow_is_white():
    floor = np.full((60, 60, 3), (200, 185, 172), np.uint8)
    light = np.zeros((60, 60), np.float32)
    light[30, 30] = 1.0
    light = 9000.0 * cv2.GaussianBlur(light, (0, 0), 2.5)
    shaded = np.clip(0.7 * floor + light[:, :, None], 0, 255).astype(np.uint8)
    rise = cv2.GaussianBlur(max_channel(cv2.subtract(shaded, floor)), (3, 3), 0)
    blob = (rise > 0.35 * rise.max()).astype(np.uint8)
    # beside the saturated core the shadow takes most where the floor was brightest: that is no colour of the light
    assert colour.chroma(colour.tint_of(blob, rise.astype(np.float32), shaded, floor)) < 0.12


def test_followed_spot():
    followed = FollowedSpot(max_gap_s=0.25)
    followed.diagonal = 1000.0

    def see(u, v, now, certain=True):
        followed.now = now
        followed.see(u, v, certain)

    assert not followed.reaches(0.0, 0.0) and not followed.expected_at(0.0, 0.0)
    assert not followed.moves() and not followed.trusted()
    for i in range(30):
        see(100.0 + 4.0 * i, 50.0, 0.04 * i)
        assert followed.moves() == (i > 2)  # it has to leave its place first
    u = 216.0
    followed.now = 30 * 0.04
    assert followed.reaches(u + 25.0, 50.0) and not followed.reaches(u + 40.0, 50.0)
    # if it goes on as it did it is 4 px further
    assert followed.expected_at(u + 4.0 + 13.0, 50.0) and not followed.expected_at(u - 12.0, 50.0)
    assert followed.expected_in((0, 0, 500, 500)) == (206, 35, 235, 65)
    assert followed.expected_in((400, 0, 500, 500)) is None
    followed.now += 0.3
    assert not followed.reaches(u, 50.0) and not followed.expected_at(u + 4.0, 50.0)
    assert followed.expected_in((0, 0, 500, 500)) is None
    for i in range(30, 60):
        see(u + 2.0 * (-1) ** i, 50.0, 0.04 * i, certain=i < 40)
        assert followed.trusted() == (i < 52)  # half a second after the last one that was certain
    assert not followed.moves()
    see(600.0, 200.0, 2.4)  # another one is no movement
    assert not followed.moves() and followed.reaches(600.0, 200.0)


def test_regions_part_a_bright_spot_from_what_it_touches():
    maxima = np.zeros((40, 40), np.uint8)
    maxima[5:35, 5:20] = 50
    maxima[20, 20] = 200
    found = regions(maxima, maxima > 18, 10, 12.0)
    assert (20 * 8, 20 * 8, 21 * 8, 21 * 8) in [region for region, _ in found]


def test_tracker_confirms_what_a_hand_can_do():
    tracker = SpotTracker(3, 8.0, 0.25, 0.05)
    at = lambda x, t: tracker.update(np.array([[x, 0.0]]), t)  # noqa: E731
    assert [at(0.0, 0.0), at(0.1, 0.04), at(0.2, 0.08)] == [[False], [False], [True]]
    assert at(3.0, 0.12) == [False]  # 70 m/s: another spot
    assert at(0.3, 0.20) == [True]  # hidden for two frames
    assert at(0.3, 0.80) == [False]  # hidden for too long
    assert at(0.3, 0.10) == [False]  # time jumped back
    assert tracker.update(np.zeros((0, 2)), 0.2) == []


def test_tracker_recalls_what_it_confirms():
    tracker = SpotTracker(3, 8.0, 0.25, 0.05)
    at = lambda x, t: (tracker.update(np.array([[x, 0.0]]), t, [t]), tracker.recalled[0])[1]  # noqa: E731
    assert [at(0.0, 0.0), at(0.1, 0.04), at(0.2, 0.08), at(0.3, 0.12)] == [[], [], [0.0, 0.04], []]
    # a flash that nothing follows is never recalled, neither is what was seen before time jumped back
    assert [at(3.0, 1.0), at(0.0, 1.04), at(0.0, 1.08), at(0.0, 1.12)] == [[], [], [], [1.04, 1.08]]
    assert [at(3.0, 2.0), at(3.0, 1.5), at(3.0, 1.54)] == [[], [], []]
    tracker.reset()
    assert tracker.recalled == []


def test_tracker_wants_the_same_colour_in_the_mean():
    # as a white glint moves by odd numbers of pixels, another place of the pattern gets most of it
    left, right, red = np.array([1.0, 0.5, 1.0, 0.5]), np.array([0.5, 1.0, 0.5, 1.0]), np.array([1.0, 0.4, 0.4, 0.1])
    tracker = SpotTracker(3, 8.0, 0.25, 0.05, min_chroma=0.3)

    def see(tint, t):
        return tracker.update(np.array([[0.0, 0.0]]), t, [t], [tint]), tracker.recalled[0]

    for i in range(40):
        assert see((left, right)[i % 2], 0.04 * i) == ([False], [])
    tracker.reset()
    assert [see(red, 2.0 + 0.04 * i) for i in range(3)] == [([False], []), ([False], []), ([True], [2.0, 2.04])]
    # once confirmed, its colour is not asked again
    assert [see(None, 2.12)[0], see(left, 2.16)[0], see(right, 2.2)[0]] == [[True]] * 3
    # another thing near a confirmed one, whose colour was not asked either, is not confirmed by that
    tracker.reset()
    assert [see(None, 3.0 + 0.04 * i)[0] for i in range(10)] == [[False]] * 10
    # what becomes coloured after a long time tells of the last second only
    tracker.reset()
    passed = [see(np.full(4, 0.9) if i < 50 else red, 4.0 + 0.04 * i) for i in range(120)]
    recalled = next(told for confirmed, told in passed if confirmed == [True])
    assert 20 <= len(recalled) <= 25 and np.ptp(recalled) <= 1.0


def test_tracker_keeps_spots_apart():
    tracker = SpotTracker(2, 1.0, 0.25, 0.05)
    tracker.update(np.array([[0.0, 0.0], [2.0, 0.0]]), 0.0)
    assert tracker.update(np.array([[2.01, 0.0], [0.01, 0.0], [1.0, 1.0]]), 0.04) == [True, True, False]


def test_statistics():
    statistics = Statistics()
    assert math.isnan(statistics.summary(0.0).latency_ms)
    for i in range(50):
        statistics.frame(10 + 0.04 * i, 10 + 0.04 * i - 0.02, 0.002, i % 2)
    statistics.refuse("no_transform")
    summary = statistics.summary(12.0)
    assert (summary.processed, summary.detected, summary.spots) == (50, 25, 25)
    assert summary.rate_hz == pytest.approx(25, rel=0.02)
    assert summary.latency_ms == pytest.approx(20) and summary.search_ms == pytest.approx(2)
    assert summary.refusals == {"no_transform": 1}
    assert statistics.summary(100.0).rate_hz == 0.0
    assert statistics.summary(1.0).processed == 50
    statistics.recall(2)
    assert (statistics.summary(12.0).detected, statistics.summary(12.0).spots) == (27, 27)


@pytest.mark.parametrize("encoding, bayer", [("bgr8", False), ("rgb8", False), ("bayer_rggb8", True), ("mono8", True)])
def test_debug_image(encoding, bayer):
    image = Scene(160, 96).render(bayer=bayer)
    picture = draw(image, encoding, [Candidate(50.2, 40.1, 6.0, confidence=0.9), Candidate(100, 50, 9, refusal="too_dark")])
    assert picture.shape == (96, 160, 3) and (picture == (0, 220, 0)).all(axis=2).any()


@pytest.mark.parametrize("name, preset", [("stationary", DetectorParams.stationary()), ("mobile", DetectorParams.mobile())])
def test_config_files_hold_the_presets(name, preset):
    config = yaml.safe_load((PACKAGE / "config" / f"{name}.yaml").read_text())
    assert DetectorParams.from_mapping(config["detector"]) == preset
    ProjectionParams.from_mapping(config["projection"])


def test_pure_modules_need_no_ros():
    modules = sorted(path.stem for path in (PACKAGE / "src" / "vb_laser_detect").glob("*.py")
                     if not path.stem.endswith("_node") and path.stem != "__init__")
    code = (
        "import sys\n"
        "class Block:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        top = name.split('.')[0]\n"
        "        if top in ('rospy', 'tf2_ros', 'cv_bridge') or top.endswith('_msgs'):\n"
        "            raise ImportError('blocked: ' + name)\n"
        "sys.meta_path.insert(0, Block())\n"
        f"import importlib\n[importlib.import_module('vb_laser_detect.' + name) for name in {modules!r}]\n"
    )
    assert len(modules) >= 8
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
