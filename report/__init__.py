"""Tables, figures and an HTML page of the results of all stages."""
