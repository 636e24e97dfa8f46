"""Measured records: files, checks, reconstruction, third-party measurements."""
