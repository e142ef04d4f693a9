"""What all tests share: examples may take as long as a busy machine needs."""

from hypothesis import settings

settings.register_profile("tactable", deadline=None)
settings.load_profile("tactable")
