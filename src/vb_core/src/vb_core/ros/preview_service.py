"""The service PreviewBorder with numpy arrays; not in `messages`, because service types take 3 MiB per node."""

from __future__ import annotations

from rospy.numpy_msg import numpy_msg

from vb_msgs.srv import PreviewBorder, PreviewBorderResponse

NumpyPreviewBorderResponse = numpy_msg(PreviewBorderResponse)


class NumpyPreviewBorder(PreviewBorder):
    """The service PreviewBorder with numpy arrays in its response. It is the same on the wire."""

    _response_class = NumpyPreviewBorderResponse
