"""Requirements turned round: which sensor keeps an error after an outage, from the covariance of its own matched filter."""
