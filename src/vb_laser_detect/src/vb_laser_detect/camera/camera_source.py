"""Reads images from a camera on this computer or in the network, or from a video file, until it is closed. No ROS.

A demuxer (PyAV) delivers packets. A packet of motion JPEG is a whole image, which is decoded only when it is searched,
and only as far as necessary, so that a late one costs nothing. Packets of other codecs build on each other, and are
decoded as they arrive. Once they are late, or one is damaged, they are skipped until the next keyframe. A file waits
until its images are taken. Whatever ends the stream is reported in one sentence, and the camera is opened again.
"""

from __future__ import annotations

import contextlib
import errno
import re
import threading
import time
import traceback
from collections import deque
from pathlib import Path
from typing import Any, Callable, Deque, Iterator, List, NamedTuple, Optional, Tuple

import av
import numpy as np
import simplejpeg

from vb_core.errors import CodedError
from vb_core.image_format import AnyPicture, HalvedPicture, Picture
from vb_laser_detect.camera.v4l2_controls import CaptureParams

_OPEN_TIMEOUT = 5.0  # [s] a phone may have to wake up
_STALL_TIMEOUT = 3.0  # [s] after this time without packets, a cable may have been unplugged
_RETRY_PERIOD = 1.0  # [s]
_POLL_PERIOD = 0.002  # [s] between two polls of a device: a blocking read could not be interrupted
_NONBLOCK = "4"  # AVFMT_FLAG_NONBLOCK has no name among FFmpeg's options
_CLOCK_LIMIT = 5.0  # [s] a device whose stamps differ more from now has no usable clock
_OFFSET_WINDOW = 500  # [packets] of which the quickest counts
# [s] while a file is late by less, its images keep their times, and a stroke's spots their distances in time
_CATCH_UP = 1.0
_QUEUED = 0.5  # [s] images read later than this are skipped instead of decoded one by one
_HALVED_ROWS = 1000  # smaller images cost little, and a spot in them has few pixels
# by a sentence's code, the FFmpeg errors that it explains; others are reported in FFmpeg's own words
_REASONS = {
    "camera_password": (av.error.HTTPUnauthorizedError, av.error.HTTPForbiddenError),
    "camera_no_stream": (av.error.HTTPNotFoundError, av.error.InvalidDataError),
    "camera_stalled": (av.error.ExitError,),
    "camera_busy": (errno.EBUSY,),
    "camera_unplugged": (errno.ENODEV, errno.ENOENT, errno.ENXIO),
    "camera_forbidden": (errno.EACCES, errno.EPERM),
    "camera_unreachable": (errno.EIO, errno.EHOSTUNREACH, errno.ENETUNREACH, errno.ETIMEDOUT, ConnectionError),
}


class CapturedImage(NamedTuple):
    """One image of a camera, not decoded to pixels yet.

    Attributes:
        stamp: [s] since 1970, when it was taken, as exactly as the source can tell.
        jpeg: as it arrived; None if the camera sends another codec.
        frame: as decoded from another codec; None for a JPEG.
        skipped_codes: why each image just before it was not decoded: "late_image", or "bad_image" if it, or one that it
            builds on, was damaged.
    """

    stamp: float
    jpeg: Optional[bytes] = None
    frame: Optional[av.VideoFrame] = None
    skipped_codes: Tuple[str, ...] = ()

    def picture(self) -> AnyPicture:
        """Returns the image; a large one is decoded only as far as needed.

        Raises:
            CodedError: "bad_image" if it is no JPEG; for a truncated JPEG only when it is decoded.
        """
        if self.jpeg is None:
            width, height = self.frame.width, self.frame.height
        else:
            with _readable():
                height, width = simplejpeg.decode_jpeg_header(self.jpeg)[:2]
        if height < _HALVED_ROWS or width % 2 or height % 2:
            return Picture(self._decode(width, height), "bgr")
        return HalvedPicture((width, height), self._decode)

    def _decode(self, width: int, height: int) -> np.ndarray:
        """Returns the pixels (H, W, 3) bgr at the image's size or half of it.

        Colours of a JPEG are not smoothed between pixels, which would take a third longer.
        """
        if self.jpeg is None:
            sized = self.frame.reformat(width, height, "bgr24", interpolation="AREA")
            return np.ascontiguousarray(sized.to_ndarray())
        size = dict(min_height=height, min_width=width)
        with _readable():
            return simplejpeg.decode_jpeg(self.jpeg, "BGR", fastupsample=True, fastdct=True, **size)


@contextlib.contextmanager
def _readable() -> Iterator[None]:
    try:
        yield
    except ValueError as error:
        raise CodedError("bad_image", f"cannot decode an image of the camera: {error}") from None


def is_device(address: str) -> bool:
    """Returns whether an address is a device of this computer."""
    return address.startswith("/dev/")


def is_network(address: str) -> bool:
    """Returns whether an address is a camera in the network."""
    return "://" in address


def is_file(address: str) -> bool:
    """Returns whether an address is a video file."""
    return not (is_device(address) or is_network(address))


def without_password(address: str) -> str:
    """Returns an address without its password, which is before the host or in the query."""
    return re.sub(r"(password|pwd)=[^&]*", r"\1=***", re.sub(r"://[^/]*@", "://", address), flags=re.IGNORECASE)


class CameraSource:
    """Reads one camera in a thread of its own.

    Args:
        address: a device (/dev/video0), an address (rtsp://, http://), or a file, which is played again and again.
        params: how to read it.
        handle: called with each image; a file waits until it returns.
        report: called with the reason whenever there are no images, and with None once they arrive.
    """

    def __init__(
        self,
        address: str,
        params: CaptureParams,
        handle: Callable[[CapturedImage], None],
        report: Callable[[Optional[CodedError]], None],
    ) -> None:
        self.address = address
        self.params = params
        self._shown_address = without_password(address)
        self._handle, self._report = handle, report
        self._skipped_codes: List[str] = []
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self) -> None:
        """Starts reading: `handle` and `report` may be called before this returns."""
        self._thread.start()

    def close(self) -> None:
        """Stops reading; waits until the camera is free for others."""
        self._closed.set()
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(_OPEN_TIMEOUT)

    def _run(self) -> None:
        while not self._closed.is_set():
            try:
                self._read()
            except CodedError as error:
                self._report(error.without_traceback())
            except Exception:  # a fault of the program must not silence the camera for good
                traceback.print_exc()
                self._report(CodedError("internal_error"))
            self._closed.wait(_RETRY_PERIOD)

    def _read(self) -> None:
        """Reads until the stream ends. A CodedError then says why."""
        try:
            with self._open() as container:
                for number, image in enumerate(self._images(container)):
                    if number == 0:
                        self._report(None)
                    if self._closed.is_set():
                        return
                    self._handle(image)
        except (av.error.FFmpegError, OSError) as error:
            raise self._fault(error) from None
        raise CodedError("camera_ended", source=self._shown_address)

    def _open(self) -> Any:
        if is_device(self.address):
            options = {"ts": "abs", "fflags": _NONBLOCK}
            if self.params.width and self.params.height:
                options["video_size"] = f"{self.params.width}x{self.params.height}"
            if self.params.rate:
                options["framerate"] = f"{self.params.rate:g}"
            # EINVAL: the device lacks this format, and FFmpeg is to choose one that it has
            with contextlib.suppress(ValueError):
                wanted = {**options, "input_format": self.params.pixel_format}
                return av.open(self.address, format="v4l2", container_options=wanted)
            return av.open(self.address, format="v4l2", container_options=options)
        options = {"rtsp_transport": "tcp", "fflags": "nobuffer"} if self.address.startswith("rtsp") else {}
        if is_network(self.address):
            return av.open(self.address, options=options, timeout=(_OPEN_TIMEOUT, _STALL_TIMEOUT))
        return av.open(str(Path(self.address).expanduser()))

    def _images(self, container: Any) -> Iterator[CapturedImage]:
        if not container.streams.video:
            raise CodedError("camera_no_stream", source=self._shown_address)
        stream = container.streams.video[0]
        # decoding in several threads would delay frames
        stream.thread_type = "SLICE"
        stream.codec_context.thread_count = 1
        packets = self._packets(container, stream)
        if stream.codec_context.name != "mjpeg":
            yield from self._decoded(packets)
            return
        for packet, offset in packets:
            if packet.size:
                yield CapturedImage(self._stamp(packet, offset), jpeg=bytes(packet))

    def _decoded(self, packets: Iterator[Tuple[Any, Optional[float]]]) -> Iterator[CapturedImage]:
        """Decodes images that depend on earlier ones."""
        missing = ""
        newest = 0.0
        decoded_at = time.monotonic()
        for packet, offset in packets:
            at = self._stamp(packet, offset)
            age = time.time() - 1e-3 * self.params.delay_ms - at
            is_late = not is_file(self.address) and age > _QUEUED
            # twice a second a keyframe is decoded even if it is late, because a network may have become slower for good
            if packet.is_keyframe and (not is_late or at - newest > _QUEUED):
                missing = ""
            elif is_late:
                missing = missing or "late_image"
            try:
                frames = [] if missing else packet.decode()
            except av.error.InvalidDataError:
                missing = "bad_image"
            if missing:
                self._skipped_codes.append(missing)
                if missing == "bad_image" and time.monotonic() - decoded_at > _STALL_TIMEOUT:
                    # a camera that is opened again begins with a keyframe
                    raise CodedError("camera_stalled", source=self._shown_address, seconds=f"{_STALL_TIMEOUT:g}")
                continue
            newest = at
            for frame in frames:
                yield CapturedImage(self._stamp(frame, offset), frame=frame, skipped_codes=tuple(self._skipped_codes))
                self._skipped_codes.clear()
            decoded_at = time.monotonic()

    def _stamp(self, item: Any, offset: Optional[float]) -> float:
        """Returns when a packet's or frame's image was taken [s]; the delay may change while the camera is read."""
        is_known = offset is not None and item.pts is not None
        stamp = float(item.pts * item.time_base) + offset if is_known else time.time()
        return stamp - 1e-3 * self.params.delay_ms

    def _packets(self, container: Any, stream: Any) -> Iterator[Tuple[Any, Optional[float]]]:
        """Yields each packet, and the offset from its time stamps to times since 1970 [s], or None if its stamps are unusable."""
        if is_device(self.address):
            return self._from_device(container, stream)
        return self._from_network(container, stream) if is_network(self.address) else self._from_file(container, stream)

    def _from_device(self, container: Any, stream: Any) -> Iterator[Tuple[Any, Optional[float]]]:
        newest = time.monotonic()
        while not self._closed.is_set():
            try:
                for packet in container.demux(stream):
                    if packet.size:
                        newest = time.monotonic()
                        stamp = float(packet.pts * packet.time_base) if packet.pts is not None else 0.0
                        offset = 0.0 if abs(time.time() - stamp) < _CLOCK_LIMIT else None
                        yield packet, offset
            except av.error.BlockingIOError:
                if time.monotonic() - newest > _STALL_TIMEOUT:
                    raise CodedError("camera_stalled", source=self.address, seconds=f"{_STALL_TIMEOUT:g}") from None
                self._closed.wait(_POLL_PERIOD)

    def _from_network(self, container: Any, stream: Any) -> Iterator[Tuple[Any, Optional[float]]]:
        # motion JPEG over HTTP has no time stamps: FFmpeg counts images
        is_stamped = self.address.startswith("rtsp")
        offsets: Deque[float] = deque(maxlen=_OFFSET_WINDOW)
        for packet in container.demux(stream):
            now = time.time()
            if not packet.size:
                continue
            if not is_stamped or packet.dts is None:
                yield packet, None
                continue
            offset = now - float(packet.dts * packet.time_base)
            if offsets and abs(offset - offsets[-1]) > _CLOCK_LIMIT:
                offsets.clear()  # the camera's clock was set
            offsets.append(offset)
            # the network delays some packets more than others: the quickest one shows how far the clocks differ
            yield packet, min(offsets)

    def _from_file(self, container: Any, stream: Any) -> Iterator[Tuple[Any, Optional[float]]]:
        """Yields packets when they are due, again and again. If it is far behind, it goes on from where it is."""
        began = time.time()
        while not self._closed.is_set():
            first, due = None, began
            for packet in container.demux(stream):
                if packet.dts is not None:
                    first = packet.dts if first is None else first
                    due = began + float((packet.dts - first) * packet.time_base)
                    behind = max(0.0, time.time() - due - _CATCH_UP)
                    began += behind
                    due += behind
                    self._closed.wait(max(0.0, due - time.time()))
                if first is not None:
                    yield packet, began - float(first * stream.time_base)
            if first is None:
                raise CodedError("camera_no_stream", source=self.address)
            began = due + float(1 / (stream.average_rate or 25))
            container.seek(0)

    def _fault(self, error: Any) -> CodedError:
        """Returns the coded error for an error of FFmpeg."""
        kinds = {*type(error).__mro__, getattr(error, "errno", None)}
        codes = [code for code, reasons in _REASONS.items() if not kinds.isdisjoint(reasons)]
        code = codes[0] if codes else "camera_fault"
        why = getattr(error, "strerror", "")
        return CodedError(code, source=self._shown_address, seconds=f"{_STALL_TIMEOUT:g}", why=why)
