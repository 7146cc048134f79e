"""CFBRL, a method for earl_jax that knows its tasks: the package registers it as `cfbrl`."""

from earl_jax_cfbrl.cfbrl import CFBRL

__all__ = ["CFBRL"]
