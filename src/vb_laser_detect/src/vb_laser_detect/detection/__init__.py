"""From an image to spots: `SpotDetector.detect` calls these stages in order, and `stage_results` is what they hand on."""
