"""PPO in one file on the vector environment, as a starting point for changes.

    python train_ppo.py --steps 400000 --out mine.onnx
    softarm evaluate mine.onnx reach

Algorithm: Schulman et al., Proximal Policy Optimization (2017), with generalised advantages; observations are
normalised by their running mean and deviation.
"""

from pathlib import Path

import gymnasium
import numpy as np
import torch
from scoring import ENVIRONMENT, Array, Score, main, score
from torch import Tensor, nn

from softarm.training.record import foreign

ROBOTS, HORIZON = 256, 16
EPOCHS, BATCHES = 4, 4
RATE, GAMMA, LAMBDA, CLIP, ENTROPY = 1e-3, 0.99, 0.95, 0.2, 0.0
# Limit of normalised observations.
CUT = 5.0


class Agent(nn.Module):
    """Actor, critic, and the statistics that normalise their observations."""

    def __init__(self, inputs: int, actions: int) -> None:
        super().__init__()
        self.actor = _network(inputs, actions, 0.01)
        self.critic = _network(inputs, 1, 1.0)
        self.log_std = nn.Parameter(torch.full((actions,), -0.5))
        self.mean, self.variance, self.count = torch.zeros(inputs), torch.ones(inputs), 1e-4

    def look(self, observation: Tensor) -> None:
        """Update the statistics with a batch of observations."""
        mean, variance, count = observation.mean(0), observation.var(0, correction=0), len(observation)
        total, apart = self.count + count, mean - self.mean
        spread = self.variance * self.count + variance * count + apart**2 * self.count * count / total
        self.mean, self.variance, self.count = self.mean + apart * count / total, spread / total, total

    def normal(self, observation: Tensor) -> Tensor:
        return ((observation - self.mean) / self.scale).clamp(-CUT, CUT)

    @property
    def scale(self) -> Tensor:
        return (self.variance + 1e-8).sqrt()

    def act(self, observation: Array) -> Array:
        """Return the mean action, without noise."""
        with torch.no_grad():
            action: Array = self.actor(self.normal(torch.from_numpy(observation))).numpy()
        return action

    def chances(self, seen: Tensor) -> torch.distributions.Normal:
        return torch.distributions.Normal(self.actor(seen), self.log_std.exp())


def _network(inputs: int, outputs: int, gain: float) -> nn.Sequential:
    layers = [nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, outputs)]
    for layer, size in zip(layers[::2], (2**0.5, 2**0.5, gain), strict=True):
        nn.init.orthogonal_(layer.weight, size)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(*layers)


def train(steps: int, seed: int = 1, show: bool = False) -> tuple[Agent, Score, Score]:
    """Train for a number of steps of single robots and return the agent and its scores before and after."""
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    envs = gymnasium.make_vec(ENVIRONMENT, num_envs=ROBOTS)
    agent = Agent(envs.single_observation_space.shape[0], envs.single_action_space.shape[0])
    optimiser = torch.optim.Adam(agent.parameters(), lr=RATE, eps=1e-5)
    observation = torch.from_numpy(envs.reset(seed=seed)[0])
    agent.look(observation)
    before = score(agent.act)
    for iteration in range(steps // (ROBOTS * HORIZON)):
        rollout, observation, reward = _roll_out(agent, envs, observation)
        _learn(agent, optimiser, *rollout)
        if show and iteration % 10 == 0:
            print(f"{(iteration + 1) * ROBOTS * HORIZON:8} steps, mean reward {reward:.4f}")
    return agent, before, score(agent.act)


def _roll_out(agent: Agent, envs: gymnasium.vector.VectorEnv, observation: Tensor):
    """Fly `HORIZON` steps and return observations, actions, log-probabilities, returns and advantages."""
    seen, done, chance, value, reward, over, last = [], [], [], [], [], [], []
    for _ in range(HORIZON):
        with torch.no_grad():
            seen.append(agent.normal(observation))
            chances = agent.chances(seen[-1])
            done.append(chances.sample())
            chance.append(chances.log_prob(done[-1]).sum(1))
            value.append(agent.critic(seen[-1])[:, 0])
        new, gained, terminated, truncated, info = envs.step(done[-1].clamp(-1.0, 1.0).numpy())
        agent.look(observation := torch.from_numpy(new))
        gain = torch.from_numpy(gained).clone()
        # An episode that ends by time keeps the value of its last state.
        if truncated.any():
            final = torch.from_numpy(np.stack(info["final_obs"][truncated]))
            with torch.no_grad():
                gain[truncated] += GAMMA * agent.critic(agent.normal(final))[:, 0]
        reward.append(gain)
        over.append(torch.from_numpy(terminated | truncated))
    with torch.no_grad():
        following = agent.critic(agent.normal(observation))[:, 0]
    advantage = torch.zeros(ROBOTS)
    for k in reversed(range(HORIZON)):
        goes_on = (~over[k]).float()
        surprise = reward[k] + GAMMA * goes_on * following - value[k]
        advantage = surprise + GAMMA * LAMBDA * goes_on * advantage
        following = value[k]
        last.insert(0, advantage)
    advantages, values = torch.cat(last), torch.cat(value)
    parts = (torch.cat(seen), torch.cat(done), torch.cat(chance), advantages, advantages + values)
    return parts, observation, float(torch.cat(reward).mean())


def _learn(agent: Agent, optimiser: torch.optim.Optimizer, seen, done, chance, advantage, returns) -> None:
    advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
    for _ in range(EPOCHS):
        for rows in torch.randperm(len(seen)).chunk(BATCHES):
            chances = agent.chances(seen[rows])
            ratio = (chances.log_prob(done[rows]).sum(1) - chance[rows]).exp()
            gain = torch.min(ratio * advantage[rows], ratio.clamp(1 - CLIP, 1 + CLIP) * advantage[rows])
            error = (agent.critic(seen[rows])[:, 0] - returns[rows]) ** 2
            loss = -gain.mean() + 0.5 * error.mean() - ENTROPY * chances.entropy().sum(1).mean()
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
            optimiser.step()


def export(agent: Agent, out: Path, seed: int = 1) -> float:
    """Write the policy's file and return the share of the validation set that it reaches."""
    return foreign.export(agent.actor, out, mean=agent.mean, scale=agent.scale, cut=CUT, seed=seed)


if __name__ == "__main__":
    main(train, export)
