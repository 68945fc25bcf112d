import sys
from pathlib import Path

import cv2

# the rendered scenes are shared by unit tests and rostests
sys.path.insert(0, str(Path(__file__).resolve().parent))
cv2.setNumThreads(1)
