"""System identification and optimal experiment design for marine vehicles."""

__version__ = "0.1.0"
