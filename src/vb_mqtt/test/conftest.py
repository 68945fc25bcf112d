import sys
from pathlib import Path

# the broker is shared by unit tests and rostests
sys.path.insert(0, str(Path(__file__).resolve().parent))
