"""From a tournament to an answer: state, causes, values, and what they explain."""
