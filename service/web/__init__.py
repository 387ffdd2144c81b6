"""What people and programs meet over HTTP: API, page, client, and the application behind them."""
