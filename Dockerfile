FROM python:3.12-slim
RUN apt-get update \
    && apt-get install --yes --no-install-recommends libatomic1 \
    && rm -rf /var/lib/apt/lists/*
COPY . /gpf
RUN pip install --no-cache-dir --constraint /gpf/requirements.lock "/gpf[pictures]"
ENV HOME=/tmp
WORKDIR /out
ENTRYPOINT ["gpf"]
CMD ["demo"]
