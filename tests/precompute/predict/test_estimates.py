"""Which estimates matter: by what a tenth of them does to the responses that every promise follows from."""

import pytest

from engine.device import Device
from precompute.predict.estimates import weigh_estimates
from tests.small_device import small_text


def test_a_full_scale_scales_its_actuator_alone_and_what_is_beside_the_model_weighs_nothing() -> None:
    text = small_text().replace('inferred = ["mass", "band"]', 'inferred = ["full_scale", "band"]')
    device = Device.parse(text, "bar")
    weighed = dict(weigh_estimates(device))
    shares = [weighed[f"actuator[{number}].full_scale"] for number in (1, 2)]
    # Together the actuators are the whole response, whose tenth is a tenth of its norm.
    assert sum(share**2 for share in shares) == pytest.approx(0.01, rel=1e-6)
    assert not {"actuator[1].band", "finger.spread", "spread.mass"} & weighed.keys()
    assert list(weighed.values()) == sorted(weighed.values(), reverse=True)
