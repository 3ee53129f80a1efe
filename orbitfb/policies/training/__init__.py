"""How the networks of policies are trained, and how a training is judged."""
