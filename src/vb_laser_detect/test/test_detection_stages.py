"""The detector's smaller parts: blocks, background, tint, regions, counts, what images lack, files in the package."""

import math
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import yaml

from spot_scenes import GREEN, RED, Scene, tinted
from vb_core.errors import CodedError
from vb_core.image_format import Picture
from vb_laser_detect.detection import features
from vb_laser_detect.detection.spot_detector import DetectorParams
from vb_laser_detect.detection.background import Background, block_maxima, blocks_around, match_lighting, max_channel
from vb_laser_detect.detection.changed_regions import find_boxes, find_regions
from vb_laser_detect.detection.projection import ProjectionParams
from vb_laser_detect.detection.stage_results import Comparison, ExpectedSpot, Spot
from vb_laser_detect.detection.detector_counts import DetectorCounts, InputWatch

PACKAGE = Path(__file__).resolve().parents[1]
NOTICES = {"no_transform": "camera_no_pose", "no_camera_info": "camera_no_lens"}  # by what images lack


@pytest.mark.parametrize("shape", [(64, 96), (64, 96, 3), (67, 101, 3), (33, 47), (171, 9000, 3)])
def test_block_maxima_are_numpys(shape):
    image, background = np.random.default_rng(1).integers(0, 256, (2, *shape), dtype=np.uint8)
    rows = shape[0] // 8
    read = [1, 3, 5, 7] if len(shape) == 3 else [1, 2, 5, 6]

    def maxima(rise):
        columns = rise.shape[1] // 8
        bands = rise[:, : columns * 8].reshape(len(rise), columns, 8).max(axis=2)
        found = bands[: rows * 8].reshape(rows, 8, columns)[:, read].max(axis=1)
        found[-1] = np.maximum(found[-1], bands[-8:][read].max(axis=0))  # remaining rows count for the last blocks
        return found

    rise = np.maximum(image.astype(int) - background, 0).reshape(*shape[:2], -1).max(axis=2)
    truth = maxima(rise)
    truth[:, -1:] = np.maximum(truth[:, -1:], maxima(rise[:, -8:]))  # and remaining columns
    assert np.array_equal(block_maxima(image, background), truth)


@pytest.mark.parametrize("u, v, marked", [(20.0, 12.0, 9), (-3.0, 4.0, 2), (-50.0, 4.0, 0), (500.0, 4.0, 0)])
def test_blocks_around_a_place_within_and_outside_the_image(u, v, marked):
    blocks = np.zeros((6, 8), bool)
    blocks[blocks_around(blocks.shape, u, v, 8.0, 1)] = True
    assert np.count_nonzero(blocks) == marked


@pytest.mark.parametrize("bayer", [False, True])
def test_relit_background_keeps_its_texture_without_the_spot(bayer):
    scene = tinted(Scene(200, 120, brightness=60.0, noise=0.0))
    before = scene.render(bayer=bayer)
    scene.floor[:, 60:] *= (1.8, 1.5, 1.2)  # warmer light
    lit = scene.render(bayer=bayer).astype(int)
    relit = match_lighting(before, scene.render([(120, 60)], bayer=bayer), 20.0)
    # the lowest nearby ratio is used, which rounding makes a little less than the true one
    assert np.abs(relit.astype(int) - lit)[10:-10, 75:-10].max() < 10
    # on the dark side, too
    assert np.abs(relit.astype(int) - before)[10:-10, 10:45].max() < 5


def test_what_a_spot_hides_stays_in_its_place_while_the_camera_moves():
    # 60 images, 0.6 px each: rounding each to whole pixels would add up to a block's width
    wide = cv2.GaussianBlur(np.random.default_rng(4).integers(0, 256, (96, 240), dtype=np.uint8), (0, 0), 3)
    wide = cv2.normalize(wide, None, 0, 255, cv2.NORM_MINMAX)

    def seen(index):
        return cv2.warpAffine(wide, np.array([[1.0, 0, -0.6 * index], [0, 1, 0]]), (160, 96), flags=cv2.INTER_CUBIC)

    background, keyframe = Background(), 0
    background.compare(Picture(seen(0), "mono"), None, [])
    for i in range(1, 61):
        motion = np.array([[1.0, 0, -0.6 * (i - keyframe)], [0, 1, 0], [0, 0, 1]])
        image = seen(i)
        left = 100 - 0.6 * i  # left side of the hidden part in this image
        image[40:56, int(left) : int(left) + 16] = 255
        comparison = background.compare(Picture(image, "mono"), motion, [])
        hidden = (slice(42, 54), slice(int(left) + 2, int(left) + 14))
        known = cv2.dilate(seen(i), np.ones((3, 3)))[hidden].astype(int)
        assert np.abs(comparison.reference[hidden] - known).mean() < 6.0, i
        background.update(Picture(image, "mono"), comparison, [Spot(left + 8.0, 48.0, 0.0)], 0.04)
        keyframe = i if background.is_keyframe else keyframe


@pytest.mark.parametrize("moved, becomes_keyframe", [(2.0, False), (100.0, True)])
def test_a_camera_that_has_moved_far_shows_another_floor(moved, becomes_keyframe):
    picture = Picture(np.full((96, 160), 90, np.uint8), "mono")
    background = Background()
    background.compare(picture, None, [])
    comparison = background.compare(picture, np.array([[1.0, 0, -moved], [0, 1, 0], [0, 0, 1]]), [])
    background.update(picture, comparison, [], 0.04)
    assert background.is_keyframe == becomes_keyframe


def tint_of(lit, floor, bayer=False):
    """Returns the tint of the light by which `lit` differs from `floor`."""
    rise = cv2.GaussianBlur(max_channel(cv2.subtract(lit, floor)), (3, 3), 0)
    blob = (rise > 0.35 * rise.max()).astype(np.uint8)
    return features.BlobLight(blob, rise, lit, floor, bayer).tint


@pytest.mark.parametrize("bayer", [False, True])
def test_tint_is_the_light_s_wherever_a_window_starts(bayer):
    scene = tinted(Scene(200, 160, noise=0.0))
    floor = scene.render(bayer=bayer)
    for light, least, most in ((RED, 0.4, 1.0), (GREEN, 0.4, 1.0), ((1.0, 1.0, 1.0), 0.0, 0.2)):
        lit = scene.render([(81, 62)], 2.5, 100.0, light, bayer=bayer)
        tints = []
        for left, top in ((60, 40), (62, 44), (58, 50)):
            window = (slice(top, top + 40), slice(left, left + 40))
            tints.append(tint_of(lit[window], floor[window], bayer))
        assert np.allclose(tints, tints[0], atol=0.02)
        assert least <= features.chroma(tints[0]) <= most
    # a Bayer pattern has four positions, two of them green; other images have three channels
    assert len(tints[0]) == (4 if bayer else 3)


def test_white_light_in_a_shadow_is_white():
    floor = np.full((60, 60, 3), (200, 185, 172), np.uint8)
    light = np.zeros((60, 60), np.float32)
    light[30, 30] = 1.0
    light = 9000.0 * cv2.GaussianBlur(light, (0, 0), 2.5)
    shaded = np.clip(0.7 * floor + light[:, :, None], 0, 255).astype(np.uint8)
    # around the saturated core the shadow darkens most the floor's brightest channel, which is not the light's colour
    assert features.chroma(tint_of(shaded, floor)) < 0.12


def test_regions_part_a_bright_spot_from_what_it_touches():
    maxima = np.zeros((40, 40), np.uint8)
    maxima[5:35, 5:22] = 50
    maxima[20, 20] = 200
    found = find_boxes(maxima, maxima > 18)
    assert (20 * 8, 20 * 8, 21 * 8, 21 * 8) in found


@pytest.mark.parametrize("u, parts", [(80.0, [(74, 34, 87, 47)]), (62.0, [(64, 34, 69, 47)]), (40.0, [])])
def test_a_region_is_searched_again_where_a_spot_is_expected(u, parts):
    rise = np.zeros((12, 20), np.uint8)
    rise[4:6, 8:12] = 50
    comparison = Comparison(rise, rise > 0, rise > 50, reference=np.zeros((96, 160), np.uint8))
    picture = Picture(np.full((96, 160), 200, np.uint8), "mono")
    expected = ExpectedSpot((u, 40.0), reach=6.0, max_width=20.0)
    for min_level, boxes in ((100.0, [(64, 32, 96, 48), *parts]), (201.0, [])):
        (region,) = find_regions(picture, comparison, min_level, [expected])
        assert region.boxes == boxes
        assert region.expected == (expected if parts else None)


def test_counts_are_since_the_start_and_rates_over_the_last_seconds():
    statistics = DetectorCounts()
    assert math.isnan(statistics.summary(0.0)["latency_ms"])
    for i in range(50):
        statistics.count_image(10 + 0.04 * i, 10 + 0.04 * i - 0.02, 0.002, i % 2)
    statistics.count_rejections("no_transform")
    summary = SimpleNamespace(**statistics.summary(12.0))
    assert (summary.processed, summary.spots) == (50, 25)
    assert summary.rate_hz == pytest.approx(25, rel=0.02)
    assert summary.latency_ms == pytest.approx(20) and summary.search_ms == pytest.approx(2)
    assert (summary.rejections, summary.rejection_counts) == (["no_transform"], [1])
    assert statistics.summary(100.0)["rate_hz"] == 0.0
    assert statistics.summary(1.0)["processed"] == 50
    statistics.count_image(12.0, 11.98, 0.002, 3)
    assert [statistics.summary(12.0)[key] for key in ("processed", "spots")] == [51, 28]


@pytest.mark.parametrize("name, preset", [("stationary", DetectorParams()), ("mobile", DetectorParams.mobile())])
def test_config_files_hold_the_presets(name, preset):
    config = yaml.safe_load((PACKAGE / "config" / f"{name}.yaml").read_text())
    assert DetectorParams.from_mapping(config["detector"] or {}) == preset
    ProjectionParams.from_mapping(config["projection"])


def fault(watch, now):
    found = watch.current_fault(float(now))
    return "" if found is None else found.code


@pytest.mark.parametrize("missing, told", {**NOTICES, "shared_frame": "shared_frame"}.items())
def test_what_images_lack_is_reported_once_it_lasts(missing, told):
    watch = InputWatch(0.0)
    error = CodedError(missing)
    for now in range(60):
        assert fault(watch, now) == (told if now > 30 else ""), "cameras and poses start one by one"
        watch.record_image(float(now), error)
    watch.record_image(60.0, None)
    assert fault(watch, 62) == ""
    watch.record_image(62.0, error)
    watch.record_image(66.0, error)
    assert fault(watch, 66.5) == told, "what was there before is missed sooner"


@pytest.mark.parametrize("started, images, silent", [(0.0, (), 1061), (50.0, (), 111), (50.0, (112.0,), 116)])
def test_silent_camera_is_reported_once_the_lab_has_started(started, images, silent):
    watch = InputWatch(started)  # 0: before simulated time
    assert fault(watch, 1000 if not started else 100) == ""
    for now in images:
        watch.record_image(now, None)
        assert fault(watch, now + 2.0) == ""
    assert fault(watch, silent) == "camera_silent"
    watch.record_image(silent + 1.0, None)
    assert fault(watch, silent + 1.5) == ""


def test_the_packaged_classifier_has_valid_curves():
    for x, y in features.packaged_classifier().curves.values():
        assert len(x) == len(y) > 1
        assert np.isfinite([x, y]).all() and (np.diff(x) > 0).all()
