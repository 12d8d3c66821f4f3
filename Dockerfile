# The service in a small image: the program, ONNX Runtime and the networks; no Python, no compiler, not root.
#
#   docker build -t rigsmith .
#   docker run --rm -p 127.0.0.1:8080:8080 -e RIGSMITH_ALLOW_ANONYMOUS=true rigsmith
#
# For others to call it, give it keys instead: -v $PWD/keys.toml:/etc/rigsmith/keys.toml -e RIGSMITH_KEYS=/etc/rigsmith/keys.toml

# ONNX Runtime's shared library, pinned by digest (tools/).
FROM python:3.12-slim-bookworm AS onnxruntime
WORKDIR /rigsmith
COPY tools tools
RUN python tools/fetch_onnxruntime.py

FROM rust:1.95-bookworm AS build
# The image's own toolchain, whatever rust-toolchain.toml would have rustup fetch.
ENV RUSTUP_TOOLCHAIN=1.95.0
WORKDIR /rigsmith
COPY Cargo.toml Cargo.lock build.rs ./
COPY .cargo .cargo
COPY proto proto
COPY src src
# Cargo wants every target of the manifest to exist, also those that are not built here.
COPY benches benches
COPY examples examples
COPY fuzz/seeds.rs fuzz/seeds.rs
RUN cargo build --release --locked --bin rigsmith

FROM debian:bookworm-slim
# ONNX Runtime and the mesh library need the C++ runtime; storage over TLS and fetching (--outgoing) need to know whom to trust.
RUN apt-get update \
    && apt-get install -y --no-install-recommends ca-certificates libstdc++6 \
    && rm -rf /var/lib/apt/lists/* \
    && useradd --uid 10001 --user-group --home-dir /var/lib/rigsmith --create-home --shell /usr/sbin/nologin rigsmith
# Where the program looks for what it needs: ../lib/rigsmith and ../share/rigsmith/models beside its own folder.
COPY --from=onnxruntime /rigsmith/third_party/onnxruntime/libonnxruntime.so /usr/local/lib/rigsmith/
COPY --from=onnxruntime /rigsmith/third_party/onnxruntime/LICENSE /rigsmith/third_party/onnxruntime/ThirdPartyNotices.txt /usr/local/share/doc/onnxruntime/
COPY LICENSE-MIT LICENSE-APACHE /usr/local/share/doc/rigsmith/
COPY models/artifacts /usr/local/share/rigsmith/models
COPY --from=build /rigsmith/target/release/rigsmith /usr/local/bin/rigsmith
USER rigsmith
WORKDIR /var/lib/rigsmith
ENV ORT_DISABLE_TELEMETRY=1 RIGSMITH_LISTEN=0.0.0.0:8080 RIGSMITH_DATA=/var/lib/rigsmith/data
EXPOSE 8080
VOLUME /var/lib/rigsmith
HEALTHCHECK --interval=10s --timeout=5s --start-period=30s --retries=3 \
    CMD ["rigsmith", "health"]
CMD ["rigsmith", "serve"]
