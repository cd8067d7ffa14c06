import numpy as np

from calib.networks.raster import ImageRaster, label_map, read

RASTER = ImageRaster(4, 20, 30)


def test_labels_spread_inside_a_plane_and_not_beyond_it() -> None:
    rng = np.random.default_rng(0)
    pixels = rng.uniform((-0.5, -0.5), (119.5, 79.5), (8000, 2))
    left, right = pixels[:, 0] < 40, pixels[:, 0] > 80  # between them nobody knows anything
    labels = np.where(left, 0, np.where(right, 3, -1)).astype(np.int32)

    told = label_map(RASTER, [(pixels[::2], labels[::2]), (pixels[1::2], labels[1::2])])

    assert (told[1:-1, :9] == 0).all()
    assert (told[1:-1, 21:] == 3).all()
    assert (told[:, 11:19] == -1).all()
    found = read(RASTER, told, np.array([[10.0, 10.0], [60.0, 40.0], [100.0, 70.0], [200.0, 10.0]]))
    assert found.tolist() == [0, -1, 3, -1]


def test_matches_where_two_planes_meet_stay_unlabelled() -> None:
    x, y = np.meshgrid(np.arange(120.0), np.arange(80.0))
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    labels = np.where(pixels[:, 0] < 60, 1, 2).astype(np.int32)

    told = label_map(RASTER, [(pixels, labels)])

    assert (told[1:-1, :14] == 1).all()
    assert (told[:, 14:16] == -1).all()
    assert (told[1:-1, 16:] == 2).all()
    assert (label_map(RASTER, [(pixels[:3], labels[:3])]) == -1).all()
