"""The wizard console: keys and screen."""
