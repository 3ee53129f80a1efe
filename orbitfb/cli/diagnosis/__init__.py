"""Commands that diagnose a record and plan the experiment that it asks for."""
