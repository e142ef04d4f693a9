"""Tests: laws, properties and recordings; they mirror the modules."""
