"""Rules of safety, broken one at a time: a unit test must notice each of them."""
