"""Tell gymnasium of the environment: importing this module is enough.

`gymnasium.make("orbitfb.gym.register:orbitfb/OrbitFeedback-v0")` imports it by itself.
"""

import gymnasium

ID = "orbitfb/OrbitFeedback-v0"
EPISODE = 20
"""Length of an episode [ticks]."""

if ID not in gymnasium.registry:
    gymnasium.register(
        ID, entry_point="orbitfb.gym.environment:OrbitFeedbackEnv", max_episode_steps=EPISODE
    )
