"""Measured records: files, checks, third-party measurements."""
