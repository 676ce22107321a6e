"""The learned velocity observer: network, data, training and prediction."""
