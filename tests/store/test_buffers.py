import pickle

import numpy as np

from nimprep.store.buffers import empty

SHAPE = (600, 700)


def test_memory_is_used_again_once_an_array_and_its_views_are_gone() -> None:
    first = empty(SHAPE, np.float32)
    place = first.ctypes.data
    view = first[100:, 5]
    del first
    assert empty(SHAPE, np.float32).ctypes.data != place
    view[:] = 7
    del view
    assert empty(SHAPE, np.float32).ctypes.data == place


def test_two_arrays_never_share_memory() -> None:
    arrays = [empty(SHAPE, np.uint8) for _ in range(10)]
    for number, array in enumerate(arrays):
        array[:] = number
    assert all((array == number).all() for number, array in enumerate(arrays))


def test_an_array_is_as_numpy_makes_it() -> None:
    for shape, dtype in ((SHAPE, np.uint16), ((600, 700, 3), np.int8), ((3, 4), np.float32)):
        array = empty(shape, dtype)
        assert array.shape == shape
        assert array.dtype == dtype
        assert array.flags.c_contiguous
        assert array.flags.writeable
        array[:] = 1
        assert np.array_equal(pickle.loads(pickle.dumps(array)), array)
