ARG BASE=python:3.11-slim-bookworm
FROM ${BASE}

WORKDIR /app
COPY requirements.lock ./
RUN pip install --no-cache-dir uv
COPY pyproject.toml README.md LICENSE ./
COPY drivers drivers
COPY service service
COPY simulator simulator
# versions and hashes from the lock, but only what the product itself needs
RUN uv pip install --system --no-cache --constraint requirements.lock --build-constraint requirements.lock .
COPY config config

RUN useradd --create-home sweepid && mkdir /data && chown sweepid /data
USER sweepid
ENV SWEEPID_DATA_DIR=/data
VOLUME /data
ENTRYPOINT ["sweepid"]
