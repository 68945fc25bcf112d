"""Exposure and white balance of a device are set by the names that its kernel has for them."""

from refusals import refused
from vb_testing import write_program
from vb_laser_detect.camera import v4l2_controls
from vb_laser_detect.camera.v4l2_controls import CaptureParams

LISTING = """
User Controls

                 white_balance_automatic 0x0098090c (bool)   : default=1 value=1
                                    gain 0x00980913 (int)    : min=0 max=255 step=1 default=0 value=0
               white_balance_temperature 0x0098091a (int)    : min=2000 max=6500 step=1 default=4000 value=4000 flags=inactive

Camera Controls

                           auto_exposure 0x009a0901 (menu)   : min=0 max=3 default=3 value=3 (Aperture Priority Mode)
                  exposure_time_absolute 0x009a0902 (int)    : min=3 max=2047 step=1 default=250 value=250 flags=inactive
"""
OLD_LISTING = LISTING.replace("auto_exposure", "exposure_auto").replace("exposure_time_absolute", "exposure_absolute")
OLD_LISTING = OLD_LISTING.replace("white_balance_automatic", "white_balance_temperature_auto")


def test_settings_not_asked_for_are_the_camera_s_own():
    found = v4l2_controls.list_control_values(LISTING, CaptureParams())
    assert found == ["auto_exposure=3", "white_balance_automatic=1"]
    ribbon = LISTING.replace("min=0 max=3 default=3 value=3", "min=0 max=1 default=0 value=1")  # only two modes
    assert v4l2_controls.list_control_values(ribbon, CaptureParams())[0] == "auto_exposure=0"
    assert v4l2_controls.list_control_values("", CaptureParams()) == []
    with refused("no_control"):
        v4l2_controls.list_control_values("", CaptureParams(exposure=100))


def test_automatic_settings_of_a_device_are_switched_off_before_values_are_set(tmp_path, monkeypatch):
    (tmp_path / "listing").write_text(LISTING)
    answer = f'echo "$@" >>{tmp_path}/calls; [ "$3" != --list-ctrls ] || cat {tmp_path}/listing'
    write_program(tmp_path / "v4l2-ctl", answer)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    params = CaptureParams(exposure=50, white_balance=9000)
    v4l2_controls.set_controls("/dev/video7", params)
    assert (tmp_path / "calls").read_text().splitlines() == [
        "-d /dev/video7 --list-ctrls",
        "-d /dev/video7 --set-ctrl=auto_exposure=1",
        "-d /dev/video7 --set-ctrl=exposure_time_absolute=50",
        "-d /dev/video7 --set-ctrl=white_balance_automatic=0",
        "-d /dev/video7 --set-ctrl=white_balance_temperature=6500",
    ]
    assert v4l2_controls.list_control_values(OLD_LISTING, params)[:2] == ["exposure_auto=1", "exposure_absolute=50"]
    write_program(tmp_path / "v4l2-ctl", "echo 'VIDIOC_S_EXT_CTRLS: failed: Permission denied' >&2; exit 1")
    with refused("control_refused") as caught:
        v4l2_controls.set_controls("/dev/video7", params)
    assert "Permission denied" in caught.value.message
