"""Points of a surface: one that is clipped by itself is the one that is clipped among others."""

from hypothesis import given
from hypothesis import strategies as st

from base.points import clip_point, clip_points, is_within

parts_m = st.floats(-1.0, 1.0)


@given(parts_m, parts_m, st.floats(0.01, 0.5), st.floats(0.01, 0.5))
def test_a_clipped_point_is_the_nearest_on_the_surface(x_m: float, y_m: float, length_m: float, width_m: float) -> None:
    for point, corner_m in ((x_m, length_m), (complex(x_m, y_m), complex(length_m, width_m))):
        clipped = clip_point(point, corner_m)
        assert clipped == clip_points(point, corner_m)
        assert is_within(clipped, corner_m) and type(clipped) is type(point)
