"""``python -m tests.benchmarks.bench.route``: one bare FastAPI route on the server that the service runs on.

It answers with the JSON it was given on standard input. Prints its port.
"""

import asyncio
import json
import socket
import sys

import uvicorn
from fastapi import FastAPI


def main() -> None:
    answer = json.loads(sys.stdin.readline())
    app = FastAPI()

    @app.get("/api/v1/campaigns/{campaign_id}")
    def campaign(campaign_id: int) -> dict[str, object]:
        return answer

    # of this protocol by name: asyncio sends small answers at once only then
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP) as listener:
        listener.bind(("127.0.0.1", 0))
        print(listener.getsockname()[1], flush=True)
        server = uvicorn.Server(uvicorn.Config(app, log_level="warning", access_log=False))
        asyncio.run(server.serve([listener]))


if __name__ == "__main__":
    main()
