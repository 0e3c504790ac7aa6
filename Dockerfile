# Blender's Python package needs Python 3.11, and libraries from libgl1 on.
FROM python:3.11-slim
RUN apt-get update \
    && apt-get install --yes --no-install-recommends libatomic1 \
        libgl1 libsm6 libx11-6 libxfixes3 libxi6 libxkbcommon0 libxrender1 libxt6 \
    && rm -rf /var/lib/apt/lists/*
COPY . /gpf
RUN pip install --no-cache-dir --constraint /gpf/requirements.lock "/gpf[pictures]"
ENV HOME=/tmp
WORKDIR /out
ENTRYPOINT ["gpf"]
CMD ["demo"]
