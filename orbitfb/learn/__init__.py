"""The background learner: refit the model, judge the candidate, promote it, roll it back."""
