import threading

import pytest

from vfm_sdm.core.threads import thread_pool


@pytest.mark.parametrize("threads", [1, 2])
def test_work_comes_back_in_order_and_errors_to_who_asks(threads):
    with thread_pool(threads) as executor:
        assert list(executor.map(abs, range(-5, 0))) == [5, 4, 3, 2, 1]
        failed = executor.submit(int, "no number")
        with pytest.raises(ValueError, match="no number"):
            failed.result()


def test_one_thread_is_the_calling_one():
    with thread_pool(1) as executor:
        assert executor.submit(threading.get_ident).result() == threading.get_ident()
    with thread_pool(2) as executor:
        assert executor.submit(threading.get_ident).result() != threading.get_ident()
