"""What every picture keeps to, whatever it shows."""

import csv
from collections.abc import Collection
from pathlib import Path

import numpy as np

from engine.device import Device
from tactable.figures.picture_file import Picture, write_columns


def check_picture(picture: Picture, device: Device, words: Collection[str], folder: Path) -> None:
    """Axes and columns have units but for `words`, estimates are named, and the CSV file is the data."""
    assert all(header.endswith(")") for header in picture.columns if header not in words)
    labels = [label for axes in picture.figure.axes for label in (axes.get_xlabel(), axes.get_ylabel()) if label]
    assert len(labels) >= 2 and all(label.endswith((")", "finger in zone")) for label in labels)
    note = " ".join(picture.figure.get_supxlabel().split())
    assert "ESTIMATES" in note and f"{len(device.estimated_values)} values of the device" in note
    assert set(device.estimated_values) <= set(picture.summary["estimated"])
    write_columns(picture, folder / "data.csv")
    with (folder / "data.csv").open(newline="", encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    assert header == list(picture.columns)
    for cells, values in zip(zip(*rows, strict=True), picture.columns.values(), strict=True):
        for cell, value in zip(cells, values, strict=True):
            if isinstance(value, str):
                assert cell == value
            else:
                assert cell == "" if value is None or np.isnan(value) else float(cell) == value
