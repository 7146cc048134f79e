"""Several hosts that run one program."""

import pytest

from earl_jax.runs.hosts import join_hosts


def test_hosts_take_auto_or_an_address_with_two_numbers():
    join_hosts(None)
    with pytest.raises(ValueError, match="--hosts takes auto or ADDRESS:PORT,HOSTS,NUMBER, not 'two'"):
        join_hosts("two")
