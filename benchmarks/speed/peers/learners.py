"""SAC for a loop in Python: the same learner as a jitted JAX function and in PyTorch."""

from typing import Any, NamedTuple

import numpy as np

from benchmarks.speed.peers.common import HIDDEN, LEARNING_RATE

DISCOUNT, TARGET_RATE, REWARD_SCALE = 0.99, 0.005, 10.0
LOG_STD_RANGE = (-20.0, 2.0)


class Batch(NamedTuple):
    """NumPy rows: `obs [B, o]`, `action [B, a]`, `reward [B]`, bool `terminal [B]`, `next_obs [B, o]`."""

    obs: np.ndarray
    action: np.ndarray
    reward: np.ndarray
    terminal: np.ndarray
    next_obs: np.ndarray


class JaxLearner:
    """earl_jax's own SAC step on one seed, called from Python as the authors call their compiled TF-Agents step."""

    packages = ("jax", "jaxlib")

    def __init__(self, obs_size: int, action_size: int):
        import jax

        from earl_jax.algos.learner.base import Batch as Rows
        from earl_jax.algos.learner.sac import SAC

        sac = SAC(learning_rate=LEARNING_RATE, hidden_sizes=HIDDEN, reward_scale=REWARD_SCALE)
        self.agent = sac.init(jax.random.key(0), obs_size, action_size)
        self.key = jax.random.key(1)

        def act(actor, obs, key):
            key, used = jax.random.split(key)
            return sac.act(used, actor, obs), key

        def update(agent, batch, key):
            key, used = jax.random.split(key)
            return sac.update(used, agent, Rows(*batch))[0], key

        self._act, self._update = jax.jit(act), jax.jit(update, donate_argnums=0)
        self._values = jax.jit(sac.q_values)
        self.device = jax.devices()[0].device_kind
        self.wait = jax.block_until_ready

    def act(self, obs: np.ndarray) -> np.ndarray:
        action, self.key = self._act(self.agent.actor, obs, self.key)
        return np.asarray(action)

    def update(self, batch: Batch) -> None:
        self.agent, self.key = self._update(self.agent, batch, self.key)

    def values(self, obs: np.ndarray, action: np.ndarray) -> np.ndarray:
        """Return both critics' values [2, B]."""
        return np.asarray(self._values(self.agent.critics, obs, action))

    def finish(self) -> None:
        """Wait for all dispatched work."""
        self.wait(self.agent)


class TorchLearner:
    """The same step in eager PyTorch: two critics, their targets, actor, temperature, three Adams."""

    packages = ("torch",)

    def __init__(self, obs_size: int, action_size: int):
        import torch

        self.torch, self.torch_device = torch, "cuda" if torch.cuda.is_available() else "cpu"
        self.device = torch.cuda.get_device_name() if self.torch_device == "cuda" else "cpu"
        torch.set_num_threads(1)  # more threads spin against each other when a core is busy: 25 times slower
        self.actor = self._net(obs_size, 2 * action_size)
        self.critics = torch.nn.ModuleList([self._net(obs_size + action_size, 1) for _ in range(2)])
        self.targets = torch.nn.ModuleList([self._net(obs_size + action_size, 1) for _ in range(2)])
        self.targets.load_state_dict(self.critics.state_dict())
        self.log_alpha = torch.zeros((), device=self.torch_device, requires_grad=True)
        groups = self.actor.parameters(), self.critics.parameters(), [self.log_alpha]
        self.adams = [torch.optim.Adam(group, lr=LEARNING_RATE) for group in groups]
        self.entropy = -0.5 * action_size

    def _net(self, inputs: int, outputs: int) -> Any:
        layers, nn = [], self.torch.nn
        for size in HIDDEN:
            layers += [nn.Linear(inputs, size), nn.ReLU()]
            inputs = size
        return nn.Sequential(*layers, nn.Linear(inputs, outputs)).to(self.torch_device)

    def _sample(self, obs: Any) -> tuple[Any, Any]:
        """Return squashed actions [B, a] and their log-probabilities [B]."""
        mean, log_std = self.actor(obs).chunk(2, dim=-1)
        normal = self.torch.distributions.Normal(mean, log_std.clamp(*LOG_STD_RANGE).exp())
        raw = normal.rsample()
        squash = 2.0 * (np.log(2.0) - raw - self.torch.nn.functional.softplus(-2.0 * raw))
        return raw.tanh(), (normal.log_prob(raw) - squash).sum(-1)

    def values(self, obs: np.ndarray, action: np.ndarray) -> np.ndarray:
        """Return both critics' values [2, B]."""
        with self.torch.no_grad():
            pair = [self.torch.as_tensor(part, device=self.torch_device) for part in (obs, action)]
            return self._values(self.critics, *pair).cpu().numpy()

    def _values(self, critics: Any, obs: Any, action: Any) -> Any:
        pair = self.torch.cat([obs, action], dim=-1)
        return self.torch.stack([critic(pair)[:, 0] for critic in critics])

    def act(self, obs: np.ndarray) -> np.ndarray:
        with self.torch.no_grad():
            return self._sample(self.torch.as_tensor(obs, device=self.torch_device)[None])[0][0].cpu().numpy()

    def update(self, batch: Batch) -> None:
        torch = self.torch
        obs, action, reward, terminal, next_obs = [torch.as_tensor(part, device=self.torch_device) for part in batch]
        alpha = self.log_alpha.exp().detach()
        with torch.no_grad():
            next_action, log_prob = self._sample(next_obs)
            value = self._values(self.targets, next_obs, next_action).amin(0) - alpha * log_prob
            target = REWARD_SCALE * reward + DISCOUNT * (~terminal) * value
        self._descend(1, 0.5 * (self._values(self.critics, obs, action) - target).square().mean(1).sum())
        fresh, log_prob = self._sample(obs)
        self.critics.requires_grad_(False)
        self._descend(0, (alpha * log_prob - self._values(self.critics, obs, fresh).amin(0)).mean())
        self.critics.requires_grad_(True)
        self._descend(2, -(self.log_alpha * (log_prob.detach() + self.entropy)).mean())
        with torch.no_grad():
            slow, fast = list(self.targets.parameters()), list(self.critics.parameters())
            torch._foreach_lerp_(slow, fast, TARGET_RATE)

    def _descend(self, group: int, loss: Any) -> None:
        self.adams[group].zero_grad(set_to_none=True)
        loss.backward()
        self.adams[group].step()

    def finish(self) -> None:
        """Wait for all dispatched work."""
        if self.torch_device == "cuda":
            self.torch.cuda.synchronize()


LEARNERS = {"jax": JaxLearner, "torch": TorchLearner}
